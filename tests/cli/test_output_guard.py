"""Nothing that a user has is overwritten unasked, by any command or option that writes.

Evidence: property, over every output of the parser, so that a new option cannot forget the guard.
"""

from __future__ import annotations

import argparse
import json
import os
import sqlite3
import stat
from datetime import date
from pathlib import Path

import pytest
from command import GOOD, call, commands, dataset, tree
from given_calibration import calibration

from calib.cli.arguments import PathRole, guard_outputs, roles
from calib.cli.main import parser
from calib.core.errors import UsageError
from calib.core.owner import Owner
from calib.stages.output_guard import RUN_FOLDER, files_of, guarded
from calib.stages.owner import claim
from calib.stages.run_folder import ALWAYS, FORMER, MANIFEST, RECORD, SOMETIMES
from calib.stages.store import Store
from tests.history.fleet import TRUTH, written

COMMANDS = list(commands(parser()))
OUTPUTS = [
    pytest.param(command, role, id=f"{command.prog} {role.option}")
    for command in COMMANDS
    for role in roles(command)
    if role.writes is not None
]
FILES = [one for one in OUTPUTS if not one.values[1].writes.is_folder]
FOLDERS = [one for one in OUTPUTS if one.values[1].writes.is_folder]


@pytest.mark.parametrize("command", COMMANDS, ids=lambda c: c.prog)
def test_every_path_has_a_role(command: argparse.ArgumentParser) -> None:
    known = {role.dest for role in roles(command)}
    for action in command._actions:
        assert action.type is not Path, action.dest
        words = f"{action.dest} {action.metavar} {action.help}".lower()
        if any(w in words.split() for w in ("out", "file", "dir", "folder", "csv", "html", "svg")):
            assert action.dest in known, action.dest


def test_commands_that_write_are_known() -> None:
    assert len(OUTPUTS) >= 9
    assert {one.values[0].prog.split()[1] for one in OUTPUTS} >= {
        "calibrate", "measure", "simulate", "compare", "plan", "study", "history",
    }  # fmt: skip


def asked(command: argparse.ArgumentParser, role: PathRole, out: Path, given: Path) -> None:
    """Guard `out` as an output of a command whose inputs are all `given`."""
    values: dict[str, object] = {"path_roles": roles(command), "force": False}
    for other in roles(command):
        values[other.dest] = given if other.writes is None else None
    guard_outputs(argparse.Namespace(**values | {role.dest: out}))


@pytest.mark.parametrize(("command", "role"), FILES)
def test_file_spares_inputs_devices_pipes_folders_and_foreign_files(
    command: argparse.ArgumentParser, role: PathRole, tmp_path: Path
) -> None:
    given, foreign, pipe = tmp_path / "input", tmp_path / "notes.txt", tmp_path / "pipe"
    given.write_text("input")
    foreign.write_text("notes")
    os.mkfifo(pipe)
    for name, target in (("to-input", given), ("to-notes", foreign)):
        (tmp_path / name).symlink_to(target)
    (tmp_path / "hard").hardlink_to(given)
    before = tree_of_files(tmp_path)
    names = ["input", "notes.txt", "pipe", "to-input", "to-notes", "hard", "."]
    for out in [*(tmp_path / name for name in names), Path("/dev/null")]:
        with pytest.raises(UsageError):
            asked(command, role, out, given)
    assert tree_of_files(tmp_path) == before
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    asked(command, role, tmp_path / "new", given)


def tree_of_files(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}


@pytest.mark.parametrize(("command", "role"), OUTPUTS)
def test_dataset_is_spared(
    command: argparse.ArgumentParser, role: PathRole, tmp_path: Path
) -> None:
    data = dataset(tmp_path / "rigs" / "data", GOOD)
    inside = [data, data / "new"] if has_input(command) else [data]
    for out in inside:
        with pytest.raises(UsageError):
            asked(command, role, out, data)


@pytest.mark.parametrize(("command", "role"), FOLDERS)
def test_folder_spares_what_is_above_files_and_folders_of_others(
    command: argparse.ArgumentParser, role: PathRole, tmp_path: Path
) -> None:
    data = dataset(tmp_path / "rigs" / "data", GOOD)
    other = tmp_path / "letters"
    other.mkdir()
    (other / "letter.txt").write_text("dear")
    for out in (data.parent, other, other / "letter.txt"):
        with pytest.raises(UsageError):
            asked(command, role, out, data)
    asked(command, role, tmp_path / "new", data)


MARKED = [
    one
    for one in FOLDERS
    if not (one.values[1].writes.is_new or one.values[1].writes is RUN_FOLDER)
]


@pytest.mark.parametrize(("command", "role"), MARKED)
def test_a_folder_is_known_by_what_its_files_say(
    command: argparse.ArgumentParser, role: PathRole, tmp_path: Path
) -> None:
    """Files of the names that the command writes, made by somebody else."""
    kind = role.writes
    assert kind is not None
    assert kind.files, "a folder that is added to needs a mark"
    by_content = {pattern: marks for pattern, marks in kind.files if marks}
    assert by_content
    for pattern, marks in by_content.items():
        folder = tmp_path / pattern.replace("*", "star").replace("/", "-")
        theirs, name = folder / pattern.replace("*", "index"), pattern.replace("*", "index")
        theirs.parent.mkdir(parents=True)
        theirs.write_text("mine\n")
        (folder / "letter.txt").write_text("dear")
        with pytest.raises(UsageError, match="another origin"):
            asked(command, role, folder, tmp_path / "none")
        theirs.write_bytes(b"\n" + marks[0] + b"\n")
        asked(command, role, folder, tmp_path / "none")
        # In a folder of its own each file is looked at.
        theirs.write_text("mine\n")
        with pytest.raises(UsageError, match="another origin"):
            files_of(folder, [name], kind, option=role.option)
        assert files_of(folder, [name], kind, option=role.option, force=True)
        # A link is written through, if its target passes.
        theirs.unlink()
        (tmp_path / "target").write_bytes(marks[0])
        theirs.symlink_to(tmp_path / "target")
        assert files_of(folder, [name], kind, option=role.option)[name] == tmp_path / "target"
        (tmp_path / "target").write_text("mine\n")
        with pytest.raises(UsageError, match="another origin"):
            files_of(folder, [name], kind, option=role.option)


RECORDS = {
    "nothing": ({}, False),
    "a run that has begun": ({RECORD: '{"from_here": "."}'}, False),
    "a manifest cut short": (
        {RECORD: '{"from_here": "."}', MANIFEST: '{"complete": true, "f'},
        False,
    ),
    "somebody's manifest": ({MANIFEST: '{"name": "a package"}'}, False),
    "a record without files": ({FORMER: "{}"}, False),
    "a record of another file": ({FORMER: '{"files": {"x.html": ""}}'}, False),
    "a record of the file": ({FORMER: '{"files": {"NAME": ""}}'}, True),
    "a manifest": ({MANIFEST: '{"complete": false}'}, True),
}


@pytest.mark.parametrize("name", [*ALWAYS, *SOMETIMES])
@pytest.mark.parametrize(("records", "is_own"), RECORDS.values(), ids=RECORDS.keys())
def test_an_output_that_no_record_of_a_run_knows_is_spared(
    records: dict[str, str], is_own: bool, name: str, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    (run / ".stages").mkdir(parents=True)
    for file, text in records.items():
        (run / file).write_text(text.replace("NAME", name))
    (run / name).write_text("mine")
    if is_own:
        assert guarded(run, RUN_FOLDER, option="--out") == run
    else:
        with pytest.raises(UsageError, match="another origin"):
            guarded(run, RUN_FOLDER, option="--out")
    assert guarded(run, RUN_FOLDER, option="--out", force=True) == run


def test_a_run_that_wrote_nothing_goes_on_beside_notes(tmp_path: Path) -> None:
    (tmp_path / ".stages").mkdir()
    claim(tmp_path, Owner(tmp_path / "d", "a" * 64))
    (tmp_path / "notes.txt").write_text("mine")
    assert guarded(tmp_path, RUN_FOLDER, option="--out") == tmp_path


def test_only_what_is_made_anew_has_no_force() -> None:
    for command in COMMANDS:
        writes = [role.writes for role in roles(command) if role.writes is not None]
        offers = "--force" in command._option_string_actions
        assert offers is any(not kind.is_new for kind in writes), command.prog


FOREIGN = {
    "export": (
        ["export", "c.json", "--format", "opencv", "--out", "OUT"],
        ("c1.yaml", "c2.yaml"), ("stereo.yaml", "# calib export"),
    ),
    "page": (
        ["history", "page", "--out", "OUT"],
        ("index.html", "R1.html"), ("R2.html", 'content="calib history page"'),
    ),
    "batch": (
        ["batch", "d", "--out", "OUT"],
        ("batch.csv",), ("batch.html", 'content="calib batch"'),
    ),
    "study": (
        ["study", "--rigs", "1", "--out", "OUT"],
        ("rigs.jsonl", "scores.csv", "ranks.svg"), ("scores.json", '"generator": "calib '),
    ),
    "calibrate": (
        ["calibrate", "d", "--out", "OUT"],
        ("report.html", "calibration.json"), (".lock", ""),
    ),
}  # fmt: skip
"""A command, files of somebody else under names that it writes, and one of its own."""


@pytest.mark.parametrize("beside_ours", [False, True])
@pytest.mark.parametrize(("arguments", "theirs", "ours"), FOREIGN.values(), ids=FOREIGN.keys())
def test_files_of_others_under_our_names_are_spared(
    arguments: list[str],
    theirs: tuple[str, ...],
    ours: tuple[str, str],
    beside_ours: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    dataset(tmp_path / "d", GOOD)
    (tmp_path / "c.json").write_text(json.dumps(calibration()))
    written(tmp_path / "runs" / "r1", TRUTH, rig="R1", day=date(2026, 1, 2))
    assert call(capsys, "history", "index", "runs").status == 0
    out = tmp_path / "out"
    out.mkdir()
    if beside_ours:
        (out / ours[0]).write_text(ours[1])
    for name in theirs:
        (out / name).write_text("mine\n")
    ended = call(capsys, *(a.replace("OUT", str(out)) for a in arguments))
    assert ended.status == 2, ended.err
    assert "another origin" in ended.err
    assert len(ended.err.splitlines()) == 1
    assert {name: (out / name).read_text() for name in theirs} == dict.fromkeys(theirs, "mine\n")


def test_a_lock_and_temporary_files_of_others_are_spared(tmp_path: Path) -> None:
    store = Store(tmp_path / "run")
    letter, notes = tmp_path / "letter", tmp_path / "run" / ".notes.part"
    letter.write_text("dear")
    notes.write_text("mine")
    with store.locked():
        assert notes.read_text() == "mine"
    (tmp_path / "run" / ".lock").unlink()
    (tmp_path / "run" / ".lock").symlink_to(letter)
    with pytest.raises(UsageError, match="cannot be written"), store.locked():
        pass
    assert letter.read_text() == "dear"


def has_input(command: argparse.ArgumentParser) -> bool:
    return any(role.writes is None for role in roles(command))


def test_force_gives_up_a_foreign_file_but_no_input(tmp_path: Path) -> None:
    role = next(r for c in COMMANDS for r in roles(c) if c.prog.endswith("measure") and r.writes)
    assert role.writes is not None
    notes = tmp_path / "notes.txt"
    notes.write_text("notes")
    assert guarded(notes, role.writes, option="--out", force=True) == notes
    with pytest.raises(UsageError, match="is an input of the same command"):
        guarded(notes, role.writes, option="--out", inputs=[notes], force=True)


def test_link_is_written_through(tmp_path: Path) -> None:
    role = next(r for c in COMMANDS for r in roles(c) if c.prog.endswith("measure") and r.writes)
    assert role.writes is not None
    target = tmp_path / "positions.csv"
    target.write_text("id,x_mm,y_mm,z_mm,u_x_mm\n")
    (tmp_path / "link").symlink_to(target)
    assert guarded(tmp_path / "link", role.writes, option="--out") == target


def test_outputs_onto_inputs_at_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    data = dataset(tmp_path / "data", GOOD | {"corners.vnl": "# mine\n"})
    (tmp_path / "c.json").write_text("{}")
    (tmp_path / "t.csv").write_text("id,x1c,y1c,alpha2_deg\n1,0.1,0.01,86\n")
    before = tree(tmp_path)
    for arguments in (
        ["measure", "c.json", "t.csv", "--out", "c.json"],
        ["measure", "c.json", "t.csv", "--out", "t.csv"],
        ["compare", "c.json", "c.json", "--out", "c.json"],
        ["calibrate", data, "--out", data],
        ["calibrate", data, "--out", data / "results"],
        ["calibrate", data, "--out", tmp_path],
        ["history", "index", data, "--index", data / "gaze.csv"],
    ):
        ended = call(capsys, *arguments)
        assert ended.status == 2, arguments
        assert ended.err.startswith("calib: "), ended.err
        assert "Traceback" not in ended.err
    assert tree(tmp_path) == before


def test_run_of_another_dataset_is_not_replaced(tmp_path: Path) -> None:
    out, first, second = (tmp_path / name for name in ("reports/day1", "rig1/day1", "rig2/day1"))
    for folder in (out / ".stages", first, second):
        folder.mkdir(parents=True)
    claim(out, Owner(first, "a" * 64, "day1", "7"))
    claim(out, Owner(first, "b" * 64, "day1", "7"))  # edited
    with pytest.raises(UsageError, match=r"--out .*rig2-day1"):
        claim(out, Owner(second, "c" * 64, "day1", "7"))
    claim(out, Owner(second, "b" * 64, "day1", "7"))  # moved
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    (tmp_path / "reports").rename(moved / "reports")
    claim(moved / "reports" / "day1", Owner(moved / "rig2" / "day1", "d" * 64, "day1", "7"))
    # Another rig's disk at the same place: by the serial number, else by the dataset's name.
    out, place = moved / "reports" / "day1", moved / "rig2" / "day1"
    with pytest.raises(UsageError, match="name day1, serial 7"):
        claim(out, Owner(place, "e" * 64, "day1", "8"))
    claim(out, Owner(place, "e" * 64, "a new name", "7"))
    with pytest.raises(UsageError, match="holds the run of another dataset"):
        claim(out, Owner(place, "f" * 64, "day1"))
    claim(out, Owner(place, "f" * 64, "a new name"))


def test_database_of_another_origin_is_not_touched(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "lab.sqlite"
    with sqlite3.connect(other) as connection:
        connection.execute("CREATE TABLE calibration (mine TEXT)")
        connection.execute("INSERT INTO calibration VALUES ('kept')")
    connection.close()
    (tmp_path / "runs").mkdir()
    before = other.read_bytes()
    ended = call(capsys, "history", "index", tmp_path / "runs", "--index", other)
    assert ended.status == 2
    assert "database of another origin" in ended.err
    assert "delete" not in ended.err
    assert other.read_bytes() == before
