"""A calibration that was edited, mixed or failed is told by whatever reads one.

Evidence: property, over every command of the parser that reads calibrations, so that a new one
cannot forget it.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command import Ended, call, commands
from given_calibration import calibration

from calib.batch.summary import line_of
from calib.batch.task import DatasetTask, Outcome
from calib.cli.arguments import PathRole, roles
from calib.cli.main import parser
from calib.cli.plan import note_broken
from calib.core.errors import UsageError
from calib.core.seal import with_digest
from calib.stages.manifest import begin_outputs, end_outputs
from calib.stages.run_folder import ALWAYS

COMMANDS = list(commands(parser()))
READERS = [
    pytest.param(command, role, id=command.prog)
    for command in COMMANDS
    for role in roles(command)
    if role.is_calibration
]

STANDARD = """\
format = 1
serial = "bar"
[[length]]
between = ["A", "B"]
length_mm = 584
u_mm = 500
"""
READINGS = "date,id,x1c,y1c,alpha2_deg\n2026-01-02,A,0.1,0,89\n2026-01-02,B,-0.1,0,80\n"

TEXTS = {
    "table": "id,x1c,y1c,alpha2_deg\na,0.05,0.1,87\n",
    "standard": STANDARD,
    "readings": READINGS,
}
"""Of what commands need besides."""


def test_readers_are_known() -> None:
    names = {one.values[0].prog.removeprefix("calib ") for one in READERS}
    assert names >= {
        "measure", "gaze", "length", "live", "export", "compare", "verify",
        "history index", "history check",
    }  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS, ids=lambda c: c.prog)
def test_whatever_reads_a_calibration_is_known_to(command: argparse.ArgumentParser) -> None:
    of = {role.dest: role for role in roles(command) if role.writes is None}
    for action in command._actions:
        said = f"{action.dest} {action.metavar} {action.help}".lower().replace(",", " ")
        words = {"calibration", "calibration.json", "calibrations", "run", "runs"}
        if action.dest in of and words & set(said.split()):
            assert of[action.dest].is_calibration, action.dest


def document(**changes: Any) -> dict[str, Any]:
    """Return a calibration as a run writes it."""
    dataset = {"name": "rig", "sha256": "0" * 64}
    return with_digest(
        {"generator": "calib", "dataset": dataset, "seed": 0} | calibration() | changes
    )


def write(folder: Path, document: dict[str, Any]) -> None:
    (folder / "calibration.json").write_text(json.dumps(document))


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of a finished run."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "runs" / "one"
    folder.mkdir(parents=True)
    begin_outputs(folder, ALWAYS)
    for name in ALWAYS:
        (folder / name).write_text("")
    (folder / "run.toml").write_text('[run]\nfinished = "2026-01-02T08:00:00+00:00"\n')
    write(folder, document())
    end_outputs(folder, "f", ALWAYS)
    for name, text in TEXTS.items():
        (tmp_path / name).write_text(text)
    return folder


def edited() -> dict[str, Any]:
    found = document()
    found["measurement"]["values"] = [132.0, *found["measurement"]["values"][1:]]
    return found


def edit(folder: Path) -> None:
    write(folder, edited())


def strip(folder: Path) -> None:
    write(folder, {key: value for key, value in edited().items() if key != "integrity"})


def unlist(folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    del manifest["files"]["calibration.json"]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    strip(folder)


def unfinish(folder: Path) -> None:
    begin_outputs(folder, ALWAYS)


def lose_manifest(folder: Path) -> None:
    (folder / ".stages").mkdir()
    (folder / "manifest.json").unlink()


def of_another_format(folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps(manifest | {"format": 2}))


def mix(folder: Path) -> None:
    """Put the calibration of another run there."""
    write(folder, document(seed=1))


def elsewhere(spoil: Callable[[Path], None]) -> Callable[[Path], None]:
    """Return what spoils a calibration that was copied away from its run."""

    def spoiled(folder: Path) -> None:
        for left in folder.iterdir():
            if left.name not in ("calibration.json", "run.toml"):
                left.unlink()
        spoil(folder)

    return spoiled


def linked(spoil: Callable[[Path], None]) -> Callable[[Path], None]:
    """Return what puts a link to a spoilt run in the place of a calibration."""

    def spoiled(folder: Path) -> None:
        other = folder.with_name(".other-one")
        shutil.copytree(folder, other)
        spoil(other)
        elsewhere(lambda _: None)(folder)
        (folder / "calibration.json").unlink()
        (folder / "calibration.json").symlink_to(other / "calibration.json")

    return spoiled


SPOILT: dict[str, Callable[[Path], None]] = {
    "edited": edit,
    "edited, digest deleted": strip,
    "edited copy": elsewhere(edit),
    "edited copy, digest deleted": elsewhere(strip),
    "of another run": mix,
    "unfinished run": unfinish,
    "manifest lost": lose_manifest,
    "manifest of another format": of_another_format,
    "struck from the manifest": unlist,
    "link into an unfinished run": linked(unfinish),
    "link to an edited one": linked(edit),
}


def asked(
    capsys: pytest.CaptureFixture[str],
    command: argparse.ArgumentParser,
    role: PathRole,
    run: Path,
    *more: str,
    as_folder: bool = False,
) -> Ended:
    """Call a command on the calibration of a run, and on nothing else that is wrong."""
    metavar = next(a.metavar for a in command._actions if a.dest == role.dest)
    given = run if as_folder or metavar == "DIR" else run / "calibration.json"
    words: list[str] = []
    for action in command._actions:
        if action.dest == role.dest:
            words += [str(given)] * (2 if command.prog == "calib compare" else 1)
        elif action.option_strings and not action.required:
            continue
        elif action.choices:
            words += [*action.option_strings[:1], str(next(iter(action.choices)))]
        elif action.dest != "help":
            words += [*action.option_strings[:1], action.dest]
    return call(capsys, *command.prog.split()[1:], *words, *more)


@pytest.mark.parametrize("spoil", SPOILT.values(), ids=SPOILT.keys())
@pytest.mark.parametrize(("command", "role"), READERS)
def test_it_is_refused_by_its_name(
    command: argparse.ArgumentParser,
    role: PathRole,
    spoil: Callable[[Path], None],
    run: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    spoil(run)
    before = {path for path in Path.cwd().rglob("*") if path.is_file()}
    for as_folder in (False, True) if command.prog == "calib compare" else (False,):
        ended = asked(capsys, command, role, run, as_folder=as_folder)
        said = ended.out + ended.err
        assert ended.status == (3 if command.prog == "calib history index" else 2), said
        assert "one" in said, said
        assert "Traceback" not in said
        if command.prog == "calib verify" and "manifest.json" not in [*map(str, run.iterdir())]:
            continue  # a copy: verify wants a run
        assert any(w in said for w in ("calibrate again", "edited", "did not finish")), said
    after = {path for path in Path.cwd().rglob("*") if path.is_file()}
    assert {path.name for path in after - before} <= {"history.sqlite", ".lock"}


def without_rig(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let commands end where they would turn to the rig: the calibration was read before."""

    def nothing(*_: object, **__: object) -> None:
        raise UsageError("no rig")

    for name in ("gaze", "length"):
        monkeypatch.setattr(f"calib.cli.{name}.opened", nothing)
    monkeypatch.setattr("calib.live.serve.serve", lambda *_, **__: None)


@pytest.mark.parametrize(("command", "role"), READERS)
def test_an_edited_one_is_used_on_demand(
    command: argparse.ArgumentParser,
    role: PathRole,
    run: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    without_rig(monkeypatch)
    for spoil in (edit, elsewhere(strip)):
        spoil(run)
        if command.prog in ("calib verify", "calib history index"):
            assert "--allow-edited" not in command._option_string_actions  # there is no demand
            continue
        ended = asked(capsys, command, role, run, "--allow-edited")
        assert "edited" not in ended.err
        if command.prog in ("calib gaze", "calib length"):
            assert ended.err == "calib: no rig\n"
        else:
            assert ended.status == 0, ended.err


@pytest.mark.parametrize(("command", "role"), READERS)
def test_a_failed_gate_is_told(
    command: argparse.ArgumentParser,
    role: PathRole,
    run: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    without_rig(monkeypatch)
    gates = [{"name": "residuals", "passed": False, "detail": "7 times as stated"}]
    write(run, document(gates=gates))
    end_outputs(run, "f", ALWAYS)
    ended = asked(capsys, command, role, run)
    if command.prog == "calib verify":
        return  # it is whole, whatever it says
    said = ended.out + ended.err
    assert "residuals" in said, said
    assert "must not be used" in said, said


def test_whole_ones_are_taken(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Negative control of all above."""
    asks = {one.values[0].prog: one.values for one in READERS}
    for name in ("measure", "compare", "export", "history index", "history check"):
        ended = asked(capsys, *asks[f"calib {name}"], run)
        assert ended.status == 0, ended.err
    assert "1 calibration found" in asked(capsys, *asks["calib history index"], run).out


def test_a_batch_and_a_plan_tell_of_a_run_that_is_not_whole(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    done = Outcome(DatasetTask("d", str(run)), "passed")
    assert line_of(done, run.parent).result == "passed"
    note_broken(run)
    assert capsys.readouterr().err == ""
    edit(run)
    line = line_of(done, run.parent)
    assert (line.result, line.figures) == ("refused", {})
    assert "is not what the run wrote" in line.remarks[0]
    note_broken(run)
    assert "is not what the run wrote" in capsys.readouterr().err


def test_what_never_ends_is_no_calibration(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calib.instrument.calibration_file.FILE_LIMIT_BYTES", 100_000)
    ended = call(capsys, "measure", "/dev/zero", "table")
    assert (ended.status, ended.err.count("\n")) == (2, 1)
    assert "too large to be a calibration" in ended.err
    ended = call(capsys, "history", "check", run / "calibration.json", "/dev/zero", "readings")
    assert ended.status == 2
    assert "too large for a check standard" in ended.err


def test_nobody_waits_for_a_pipe_that_lies_in_a_folder(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run / "manifest.json").rename(run / "kept")
    os.mkfifo(run / "manifest.json")
    ended = call(capsys, "measure", run / "calibration.json", "table")
    assert (ended.status, "missing or damaged" in ended.err) == (2, True)
    (run / "manifest.json").unlink()
    (run / "kept").rename(run / "manifest.json")
    for name in ("report.html", "calibration.json"):
        (run / name).unlink()
        os.mkfifo(run / name)
        ended = call(capsys, "verify", run)
        assert (ended.status, "no plain file" in ended.err) == (2, True)
    ended = call(capsys, "compare", run, run)
    assert (ended.status, "no plain file" in ended.err) == (2, True)
    ended = call(capsys, "history", "index", run)
    assert (ended.status, "no calibrations found" in ended.out) == (3, True)
