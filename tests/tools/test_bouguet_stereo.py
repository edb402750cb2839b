"""Evidence: regression. The tool on a small package made here; the real one needs the network."""

from __future__ import annotations

import importlib.util
import subprocess
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

from calib.dataset.load import load_dataset

TOOL = Path(__file__).parents[2] / "tools" / "bouguet_stereo.py"


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("bouguet_stereo", TOOL)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def picture(side: str, number: int) -> bytes:
    """A picture that tells of which camera it is, and which."""
    grey = np.full((480, 640), number + 100 * (side == "right"), np.uint8)
    return bytes(cv2.imencode(".jpg", grey)[1])


def package(folder: Path, numbers: tuple[int, ...]) -> Path:
    """A Debian package with pictures of these numbers, and some that are not wanted."""
    root = folder / "root"
    data = root / "usr/share/doc/opencv-doc/examples/data"
    data.mkdir(parents=True)
    (root / "DEBIAN").mkdir()
    (root / "DEBIAN/control").write_text(
        "Package: opencv-doc\nVersion: 1\nArchitecture: all\nMaintainer: none <none@none>\n"
        "Description: for a test\n"
    )
    for side in ("left", "right"):
        (data / f"{side}.jpg").write_bytes(b"not wanted")
        for number in numbers:
            (data / f"{side}{number:02d}.jpg").write_bytes(picture(side, number))
    deb = folder / "opencv-doc.deb"
    subprocess.run(["dpkg-deb", "--build", root, deb], check=True, capture_output=True)
    return deb


def test_the_thirteen_pairs_make_a_dataset(tool: ModuleType, tmp_path: Path) -> None:
    deb, out = package(tmp_path, tool.PAIRS), tmp_path / "bouguet-stereo"
    assert tool.main([str(out), "--deb", str(deb)]) == 0
    dataset = load_dataset(out)
    assert len(dataset.images["c1"]) == len(dataset.images["c2"]) == 13
    assert dataset.gaze is None
    assert (out / "c1/14.jpg").read_bytes() == picture("left", 14)
    assert (out / "c2/01.jpg").read_bytes() == picture("right", 1)


@pytest.mark.parametrize(
    ("made", "message"),
    [
        ("incomplete", "lacks 2 of the 26 pictures, among them number 14 of c1"),
        ("no package", "no readable Debian package"),
        ("occupied", "exists already"),
    ],
)
def test_what_cannot_be_made_is_said_and_leaves_nothing(
    tool: ModuleType,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    made: str,
    message: str,
) -> None:
    deb, out = package(tmp_path, tool.PAIRS[:-1]), tmp_path / "out" / "bouguet-stereo"
    out.parent.mkdir()
    if made == "no package":
        deb.write_text("no package")
    if made == "occupied":
        out.mkdir()
        (out / "mine").touch()
    assert tool.main([str(out), "--deb", str(deb)]) == 2
    assert message in capsys.readouterr().err
    assert [p.name for p in out.parent.iterdir()] == (
        ["bouguet-stereo"] if made == "occupied" else []
    )


def test_without_apt_the_way_out_is_told(
    tool: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(tool.DatasetError, match="no apt-get on this machine; fetch opencv-doc"):
        tool.download(tmp_path)


def test_a_failing_apt_is_quoted(
    tool: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    apt = tmp_path / "apt-get"
    apt.write_text("#!/bin/sh\necho 'E: Unable to locate package opencv-doc' >&2\nexit 100\n")
    apt.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin:/usr/bin")
    with pytest.raises(tool.DatasetError, match=r"Unable to locate package.*run apt-get update"):
        tool.download(tmp_path)
