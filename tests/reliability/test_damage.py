"""Stage files that were damaged or forged: computed again or refused, never believed or executed.

Evidence: property.
"""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calib.core.arrays import FloatArray
from calib.core.errors import CalibError
from calib.core.hdf5 import hdf5_arrays, hdf5_bytes
from calib.stages import step
from calib.stages.stage_file import (
    DOCUMENT,
    SEAL_BYTES,
    Failure,
    is_intact,
    pack,
    read,
    with_header,
)
from calib.stages.store import Step, Store


@dataclass(frozen=True)
class Inner:
    name: str
    count: int


@dataclass(frozen=True)
class Result:
    """A stage's result with something of every kind."""

    value: float
    flag: bool
    texts: tuple[str, ...]
    inner: Inner
    array: FloatArray
    perhaps: float | None = None


def compute() -> Result:
    """Return what the stage of these tests computes."""
    return Result(0.5, True, ("a", "ß"), Inner("x", 3), np.arange(12.0).reshape(3, 4))


FINGERPRINT = "f" * 64


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "stage.h5"
    file.write_bytes(with_header(FINGERPRINT, pack(compute())))
    return file


def same(a: Result, b: Result) -> bool:
    return np.array_equal(a.array, b.array) and (a.value, a.texts, a.inner) == (
        b.value,
        b.texts,
        b.inner,
    )


def test_what_is_written_is_read(path: Path) -> None:
    assert is_intact(path, FINGERPRINT)
    assert not is_intact(path, "0" * 64)
    assert same(read(path, Result), compute())
    with h5py.File(path) as file:  # HDF5 allows for the seal before it
        assert file["array0000"].shape == (3, 4)


def test_failure_is_kept(tmp_path: Path) -> None:
    (tmp_path / "f.h5").write_bytes(with_header(FINGERPRINT, pack(Failure("too few rows"))))
    assert read(tmp_path / "f.h5", Result) == Failure("too few rows")


@given(position=st.integers(0), bit=st.integers(0, 7))
@settings(
    max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None
)
def test_every_flipped_bit_is_seen(path: Path, position: int, bit: int) -> None:
    data = bytearray(path.read_bytes())
    data[position % len(data)] ^= 1 << bit
    other = path.with_name("flipped.h5")
    other.write_bytes(data)
    assert not is_intact(other, FINGERPRINT)


@pytest.mark.parametrize("cut", [0, 1, SEAL_BYTES - 1, SEAL_BYTES, SEAL_BYTES + 100, -1])
def test_every_truncation_is_seen(path: Path, cut: int) -> None:
    path.write_bytes(path.read_bytes()[:cut])
    assert not is_intact(path, FINGERPRINT)


def test_damaged_stage_is_computed_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(step, "code_fingerprint", lambda _: "code")
    first = Store(tmp_path)
    first.run(Step("a/b", compute, ()))
    file = tmp_path / ".stages" / "a--b.h5"
    good = file.read_bytes()
    assert Store(tmp_path).run(Step("a/b", compute, ())).name == "a/b"
    file.write_bytes(good[:-1] + bytes([good[-1] ^ 1]))
    second = Store(tmp_path)
    assert same(second.run(Step("a/b", compute, ())).value, compute())
    assert list(second.durations) == ["a/b"]
    assert file.read_bytes() == good


class Trap:
    """What a forged file would like to have run."""

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[str]]:
        return exec, ("raise SystemExit('a stage file was executed')",)


def forged(path: Path, document: object, fill: Callable[[h5py.File], None]) -> None:
    """Write a file whose seal is right and whose content is not."""
    text = json.dumps([False, document]).encode()

    def content(file: h5py.File) -> None:
        file.create_dataset(DOCUMENT, data=np.frombuffer(text, np.uint8))
        fill(file)

    image = hdf5_bytes(content)
    path.write_bytes(with_header(FINGERPRINT, image))


GOOD = {
    "value": 0.5,
    "flag": True,
    "texts": ["a"],
    "inner": {"name": "x", "count": 3},
    "array": {"array": "array0000"},
    "perhaps": None,
}


def floats(file: h5py.File) -> None:
    file["array0000"] = np.arange(3.0)


def pickled(file: h5py.File) -> None:
    file["array0000"] = np.frombuffer(pickle.dumps(Trap()), np.uint8)


def texts(file: h5py.File) -> None:
    file.create_dataset("array0000", data=["a", "b"], dtype=h5py.string_dtype())


def references(file: h5py.File) -> None:
    file.create_dataset("array0000", data=[file.ref], dtype=h5py.ref_dtype)


def link(file: h5py.File) -> None:
    file["array0000"] = h5py.ExternalLink("/etc/passwd", "/x")


def soft_link(file: h5py.File) -> None:
    file["real"] = np.arange(3.0)
    file["array0000"] = h5py.SoftLink("/real")


def external(file: h5py.File) -> None:
    file.create_dataset("array0000", (4,), "f8", external=[("/etc/passwd", 0, 32)])


def enormous(file: h5py.File) -> None:
    file.create_dataset("array0000", (10**12,), "f8", chunks=(1000,))


def group(file: h5py.File) -> None:
    file.create_group("array0000")


def nested(depth: int) -> object:
    value: object = []
    for _ in range(depth):
        value = [value]
    return value


FORGED: dict[str, tuple[object, Callable[[h5py.File], None]]] = {
    "pickle": (GOOD, pickled),
    "texts for numbers": (GOOD, texts),
    "references": (GOOD, references),
    "a link to another file": (GOOD, link),
    "a soft link": (GOOD, soft_link),
    "data of another file": (GOOD, external),
    "terabytes": (GOOD, enormous),
    "a group": (GOOD, group),
    "no array": (GOOD, lambda _: None),
    "text for a number": (GOOD | {"value": "0.5"}, floats),
    "number for a text": (GOOD | {"texts": [1]}, floats),
    "int for a bool": (GOOD | {"flag": 1}, floats),
    "bool for an int": (GOOD | {"inner": {"name": "x", "count": True}}, floats),
    "float for an int": (GOOD | {"inner": {"name": "x", "count": 3.0}}, floats),
    "text for an optional": (GOOD | {"perhaps": "none"}, floats),
    "list for an object": (GOOD | {"inner": ["x", 3]}, floats),
    "null for an object": (GOOD | {"inner": None}, floats),
    "text for a list": (GOOD | {"texts": "ab"}, floats),
    "a key too many": (GOOD | {"more": 1}, floats),
    "a key too few": ({k: v for k, v in GOOD.items() if k != "value"}, floats),
    "no object": (3, floats),
    "a list": ([1, 2], floats),
    "reference to nowhere": (GOOD | {"array": {"array": "other"}}, floats),
    "reference that is none": (GOOD | {"array": [1.0]}, floats),
    "deep": (nested(900), floats),
}


@pytest.mark.parametrize(("document", "fill"), FORGED.values(), ids=FORGED.keys())
def test_forged_file_is_refused(
    tmp_path: Path, document: object, fill: Callable[[h5py.File], None]
) -> None:
    path = tmp_path / "forged.h5"
    forged(path, document, fill)
    with pytest.raises(CalibError, match=r"damaged .*; delete it and run again"):
        read(path, Result)


def test_the_forger_could_also_write_a_right_one(tmp_path: Path) -> None:
    # Control: what is refused above is refused for its content, not for how it is written.
    forged(tmp_path / "f.h5", GOOD, floats)
    assert read(tmp_path / "f.h5", Result).inner == Inner("x", 3)


@given(noise=st.binary(max_size=400), at=st.integers(0, 4000))
@settings(
    max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None
)
def test_spoilt_hdf5_raises_value_error(path: Path, noise: bytes, at: int) -> None:
    image = bytearray(path.read_bytes()[SEAL_BYTES:])
    at %= len(image)
    image[at : at + len(noise)] = noise
    try:
        arrays = hdf5_arrays(bytes(image))
    except ValueError:
        return
    assert all(a.dtype.kind in "biuf" for a in arrays.values())


def test_seal_is_of_the_content(path: Path) -> None:
    data = path.read_bytes()
    assert sha256(data[SEAL_BYTES:]).hexdigest().encode() in data[:SEAL_BYTES]
    assert FINGERPRINT.encode() in data[:SEAL_BYTES]
