"""A set of outputs is of one run and untouched, or is refused by whatever reads it.

Evidence: property. A second run's outputs are written over those of a first, and stopped at random
moments: by SIGKILL, and by a file system that takes no more.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from short_chain import dataset, shorten

from calib.chain.outputs import write_set
from calib.cli.main import main
from calib.core.errors import CalibError
from calib.history.read import read_run
from calib.instrument.calibration_file import read_calibration
from calib.stages.manifest import faults
from calib.stages.run_folder import MANIFEST

TRIALS = 30
OUTPUTS = {
    "calibration.json", "results.h5", "report.html", "run.toml",
    "certificate.html", "certificate.pdf", "certificate.xml",
}  # fmt: skip


@dataclass(frozen=True)
class TwoRuns:
    """Folders of two finished runs of one dataset by different seeds."""

    data: Path
    first: Path
    second: Path


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> TwoRuns:
    top = tmp_path_factory.mktemp("runs")
    data = dataset(top / "data")
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch.setattr)
        for seed, name in ((1, "first"), (2, "second")):
            main(["calibrate", str(data), "--out", str(top / name), "--seed", str(seed)])
    return TwoRuns(data, top / "first", top / "second")


def outputs(folder: Path) -> dict[str, bytes]:
    """Return the files of a run."""
    return {name: (folder / name).read_bytes() for name in sorted(OUTPUTS)}


def write_second(folder: Path, runs: TwoRuns) -> None:
    write_set(folder, outputs(runs.second), fingerprint="second")


def stopped_at(moment: int, stop: Callable[[], None], work: Callable[[], None]) -> None:
    """Do the work, and stop it at the system call of that number that changes the disk.

    If it comes to its end, the exit status is the number of those calls.
    """
    left = moment

    def counted(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal left
        writing = event == "open" and isinstance(arguments[2], int) and arguments[2] & os.O_WRONLY
        if not (writing or event in ("os.rename", "os.remove")):
            return
        left -= 1
        if left == 0:
            stop()

    sys.addaudithook(counted)
    work()
    os._exit(min(moment - left, 100))


def in_a_child(work: Callable[[], None]) -> int:
    """Do the work in a fork, return how that ended."""
    pid = os.fork()
    if pid == 0:
        try:
            work()
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def kill() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fill() -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def moments(runs: TwoRuns, folder: Path) -> list[int]:
    """Return when to stop: at the first call, any call, or some calls after the last."""
    shutil.copytree(runs.first, folder)
    calls = in_a_child(lambda: stopped_at(10_000, kill, lambda: write_second(folder, runs)))
    assert calls > 2 * len(OUTPUTS)
    return [1, *np.random.default_rng(20261127).integers(1, calls + 4, TRIALS - 1).tolist()]


def is_refused(folder: Path, table: Path) -> bool:
    """Return whether those who read the folder refuse it; all must agree."""
    try:
        read_run(folder)
    except CalibError:
        refused = True
    else:
        refused = False
    status = main(["compare", str(folder), str(folder)])
    assert (status == 2) is refused
    measured = main(["measure", str(folder / "calibration.json"), str(table), "--accept-failed"])
    if measured == 2:
        assert refused
    assert (main(["verify", str(folder)]) == 2) is refused
    return refused


@pytest.mark.parametrize("stop", [kill, fill], ids=["killed", "disk full"])
def test_no_mixed_set_is_accepted(
    stop: Callable[[], None], runs: TwoRuns, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "t.csv"
    table.write_text("id,x1c,y1c,alpha2_deg\na,0.05,0,86.2\n")
    before, after = outputs(runs.first), outputs(runs.second)
    seen = {"first": 0, "second": 0, "refused": 0}
    for k, moment in enumerate(moments(runs, tmp_path / "whole")):
        folder = tmp_path / str(k)
        shutil.copytree(runs.first, folder)
        in_a_child(lambda m=moment, f=folder: stopped_at(m, stop, lambda: write_second(f, runs)))
        if is_refused(folder, table):
            seen["refused"] += 1
        else:
            found = outputs(folder)
            assert found in (before, after), f"a mixed set passes after stop {moment}"
            seen["first" if found == before else "second"] += 1
        shutil.rmtree(folder)
    capsys.readouterr()
    # The trial is worth something: most stops hit the middle, some the first or come too late.
    assert seen["refused"] >= TRIALS / 2, seen
    assert seen["first"], seen
    assert seen["second"], seen


def test_a_stopped_set_is_mended_by_the_next_run(
    runs: TwoRuns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(runs.first, folder)
    in_a_child(lambda: stopped_at(6, kill, lambda: write_second(folder, runs)))
    assert faults(folder)
    shorten(monkeypatch.setattr)
    main(["calibrate", str(runs.data), "--out", str(folder), "--seed", "1"])
    assert faults(folder) == ()
    assert read_run(folder).measuring.calibrated_mm[0] > 0
    same = (folder / "calibration.json").read_bytes()
    assert same == (runs.first / "calibration.json").read_bytes()


@pytest.mark.parametrize("name", sorted(OUTPUTS))
def test_every_touched_or_missing_file_is_named(
    name: str, runs: TwoRuns, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(runs.first, folder)
    assert main(["verify", str(folder)]) == 0
    content = (folder / name).read_bytes()
    (folder / name).write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    assert main(["verify", str(folder)]) == 2
    assert f"{folder / name}: is not what the run wrote" in capsys.readouterr().err
    (folder / name).unlink()
    assert main(["verify", str(folder)]) == 2
    assert f"{folder / name}: cannot be read" in capsys.readouterr().err


def test_the_certificate_states_what_it_certifies(runs: TwoRuns) -> None:
    digest = sha256((runs.first / "calibration.json").read_bytes()).hexdigest()
    assert digest in (runs.first / "certificate.html").read_text()
    assert digest in (runs.first / "certificate.xml").read_text()
    assert digest not in (runs.second / "certificate.html").read_text()


def test_a_certificate_of_another_run_is_found_out(
    runs: TwoRuns, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Property: also where somebody made the manifest agree."""
    folder = tmp_path / "run"
    shutil.copytree(runs.first, folder)
    for name in ("certificate.html", "certificate.xml", "certificate.pdf"):
        shutil.copy(runs.second / name, folder / name)
    manifest = json.loads((folder / MANIFEST).read_text())
    for name in manifest["files"]:
        manifest["files"][name] = sha256((folder / name).read_bytes()).hexdigest()
    (folder / MANIFEST).write_text(json.dumps(manifest))
    assert main(["verify", str(folder)]) == 2
    assert "certificate.html: does not certify the calibration.json" in capsys.readouterr().err


def larger_baseline(document: dict[str, object]) -> None:
    measurement = document["measurement"]
    measurement["values"][0] *= 1.1  # type: ignore[index] # a list of numbers


def smaller_covariance(document: dict[str, object]) -> None:
    m = document["measurement"]
    assert isinstance(m, dict)
    m["covariance"] = [[v * 1e-12 for v in row] for row in m["covariance"]]


@pytest.mark.parametrize("edit", [larger_baseline, smaller_covariance])
@pytest.mark.parametrize("place", ["in its run", "copied elsewhere"])
def test_an_edited_calibration_is_told(
    edit: Callable[[dict[str, object]], None],
    place: str,
    runs: TwoRuns,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder, table = tmp_path / "run", tmp_path / "t.csv"
    table.write_text("id,x1c,y1c,alpha2_deg\na,0.05,0,86.2\n")
    shutil.copytree(runs.first, folder)
    file = folder / "calibration.json"
    if place == "copied elsewhere":
        file = Path(shutil.copy(file, tmp_path / "calibration.json"))
    document = json.loads(file.read_text())
    edit(document)
    file.write_text(json.dumps(document, indent=1))
    with pytest.raises(CalibError, match="edited"):
        read_calibration(file)
    assert main(["measure", str(file), str(table)]) == 2
    assert "--allow-edited" in capsys.readouterr().err
    assert main(["compare", str(runs.second), str(file)]) == 2
    used = ["--allow-edited", "--accept-failed"]
    assert main(["measure", str(file), str(table), *used]) == 0
    assert main(["compare", str(runs.second), str(file), *used]) == 0
    # Another layout of the same content is not an edit.
    kept = json.loads((runs.first / "calibration.json").read_text())
    copy = tmp_path / "reformatted.json"
    copy.write_text(json.dumps(kept, sort_keys=True))
    assert read_calibration(copy).calibrated_mm[0] > 0


def test_runs_of_versions_without_a_manifest_are_taken_as_they_are(
    runs: TwoRuns, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(runs.first, folder)
    (folder / MANIFEST).unlink()
    with pytest.raises(CalibError, match="did not finish"):
        read_run(folder)
    (folder / ".stages" / "outputs.json").write_text("{}")
    assert read_run(folder).model
