"""What commands say to people and to programs. Evidence: property."""

from __future__ import annotations

import io
import json
import os
import pty
import shlex
import subprocess
import sys
import termios
import threading
import time
from pathlib import Path

import pytest
from command import CALIB, GOOD, call, dataset

from calib.cli import console as console_module
from calib.cli.console import Console
from calib.cli.examples import EXAMPLES, leaves
from calib.cli.main import parser
from calib.cli.voice import as_json_lines, painted

COMMANDS = [leaf.prog for leaf in leaves(parser())]


@pytest.mark.parametrize("prog", COMMANDS)
def test_each_help_has_examples_that_parse(prog: str) -> None:
    """A new command cannot forget them: the list is the parser's."""
    (leaf,) = (one for one in leaves(parser()) if one.prog == prog)
    text = leaf.format_help()
    assert "examples:" in text
    for example in EXAMPLES[prog]:
        assert f"  {example}" in text
        words = shlex.split(example.split(" > ")[0])
        parsed = parser().parse_args(words[1:])
        assert callable(parsed.run)


def test_check_in_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = call(capsys, "check", dataset(tmp_path / "good"), "--json")
    assert good.status == 0
    told = json.loads(good.out)
    assert told["name"] == "rig"
    assert (told["problems"], told["found"]) == ([], {"gaze rows": 6})
    bad_files = GOOD | {"gaze.csv": str(GOOD["gaze.csv"]).replace("86.150", "none")}
    bad = call(capsys, "check", dataset(tmp_path / "bad", bad_files), "--json")
    assert bad.status == 2
    (problem,) = json.loads(bad.out)["problems"]
    assert problem["where"] == "gaze.csv, line 2 (id 1), column alpha2_deg"
    assert problem["remedy"]
    assert "line 2 (id 1)" in bad.err


def test_quiet_check_says_only_what_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = call(capsys, "check", dataset(tmp_path / "good"), "--quiet")
    assert (good.status, good.out, good.err) == (0, "", "")
    manifest = str(GOOD["dataset.toml"]).replace("u_z_rel = 0.002", "u_z_rel = 0.2")
    doubted = dataset(tmp_path / "doubted", GOOD | {"dataset.toml": manifest})
    assert call(capsys, "check", doubted, "-q").out.startswith("warning: [gaze] u_z_rel")


def test_rows_in_json_lines() -> None:
    """Ids stay text, no figure and no limit are null, pieces may end anywhere between rows."""
    got: list[str] = []
    put = as_json_lines(got.append)
    put("id,x_mm,z_high95_mm,status\n")
    put('7,1.5,inf,ok\n"a ""b""",,,alpha2_deg is empty\n')
    rows = [json.loads(line) for line in "".join(got).splitlines()]
    assert rows == [
        {"id": "7", "x_mm": 1.5, "z_high95_mm": None, "status": "ok"},
        {"id": 'a "b"', "x_mm": None, "z_high95_mm": None, "status": "alpha2_deg is empty"},
    ]


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_colours_are_for_terminals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    assert painted("warning", "yellow", _Terminal()) == "\033[33mwarning\033[0m"
    assert painted("warning", "yellow", io.StringIO()) == "warning"
    monkeypatch.setenv("TERM", "dumb")
    assert painted("warning", "yellow", _Terminal()) == "warning"
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("NO_COLOR", "1")
    assert painted("warning", "yellow", _Terminal()) == "warning"


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_completion_is_of_all_commands(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    script = call(capsys, "completion", shell).out
    for prog in COMMANDS:
        assert prog.split()[-1] in script
    assert "--accept-failed" in script


def complete(tmp_path: Path, script: str, line: str) -> list[str]:
    """Return what bash offers at the end of a line."""
    (tmp_path / "calib.bash").write_text(script)
    words = line.split(" ")
    code = (
        f"source {shlex.quote(str(tmp_path / 'calib.bash'))}\n"
        f"COMP_WORDS=({' '.join(map(shlex.quote, words))}); COMP_CWORD={len(words) - 1}\n"
        "_shtab_calib\n"
        'printf "%s\\n" "${COMPREPLY[@]}"\n'
    )
    done = subprocess.run(
        ["bash", "--norc", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    return done.stdout.split()


def test_completion_loads_in_bash(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Independent tool: bash itself."""
    script = call(capsys, "completion", "bash").out
    assert complete(tmp_path, script, "calib mea") == ["measure"]
    assert "--accept-failed" in complete(tmp_path, script, "calib measure --acc")
    (tmp_path / "rig-one").mkdir()
    assert complete(tmp_path, script, "calib check rig") == ["rig-one"]


class _Watched:
    """A terminal, and how often what is shown on it changes."""

    def __init__(self) -> None:
        self._keyboard, screen = pty.openpty()
        termios.tcsetwinsize(screen, (24, 80))
        self.stream = os.fdopen(screen, "w")
        self.seen: list[bytes] = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        try:
            while piece := os.read(self._keyboard, 65536):
                self.seen.append(piece)
        except OSError:
            return

    def close(self) -> str:
        self.stream.close()
        self._thread.join()
        os.close(self._keyboard)
        return b"".join(self.seen).decode()


WANTED_UPDATES = 5


@pytest.mark.parametrize("steps", [False, True])
def test_a_long_stage_moves_though_it_says_nothing(
    steps: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Updates are counted, however long they take: the test waits for them, or for ever."""
    watched = _Watched()
    monkeypatch.setattr(sys, "stderr", watched.stream)
    monkeypatch.setattr(console_module, "HEARTBEAT_S", 0.01)
    console = Console()
    console.announce("intrinsics c1")
    if steps:
        console.progress("intrinsics c1", 1, 4)
    while len(watched.seen) < WANTED_UPDATES:
        time.sleep(0.01)
    console.close()
    counted = len(watched.seen)
    console.close()
    shown = watched.close()
    assert counted >= WANTED_UPDATES
    assert shown.count("intrinsics c1: ") >= WANTED_UPDATES - 1
    assert ("1/4" in shown) is steps


def test_nothing_moves_after_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    watched = _Watched()
    monkeypatch.setattr(sys, "stderr", watched.stream)
    monkeypatch.setattr(console_module, "HEARTBEAT_S", 0.01)
    before = threading.active_count()
    console = Console()
    console.announce("one")
    assert threading.active_count() == before + 1
    console.close()
    assert threading.active_count() == before
    watched.close()


def test_quiet_console_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = _Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    console = Console(quiet=True)
    console.announce("one")
    console.progress("one", 1, 2)
    console.close()
    assert stream.getvalue() == ""


def test_a_run_on_a_terminal_moves_between_its_stages(tmp_path: Path) -> None:
    """A whole command under a terminal of its own: bytes come while images are rendered."""
    keyboard, screen = pty.openpty()
    termios.tcsetwinsize(screen, (24, 80))
    process = subprocess.Popen(
        [CALIB, "study", "--rigs", "1", "--condition", "base-6", "--out", tmp_path / "s"],
        stderr=screen,
        stdout=subprocess.DEVNULL,
    )
    os.close(screen)
    pieces = []
    try:
        while piece := os.read(keyboard, 65536):
            pieces.append(piece)
    except OSError:
        pass
    assert process.wait() in (0, 3)
    os.close(keyboard)
    assert b"rigs" in b"".join(pieces)


WITHOUT_JSON = {
    "calib capture intrinsics": "guided by hand; its outcome is the folder",
    "calib capture stereo": "guided by hand; its outcome is the folder",
    "calib capture sweep": "guided by hand; its outcome is the folder",
    "calib completion": "prints a script",
    "calib history chart": "writes a drawing",
    "calib history page": "writes pages",
    "calib live": "serves a page",
    "calib schema": "prints JSON as it is",
    "calib simulate": "writes a dataset, truth.json in it",
    "calib study": "writes scores.json",
}
WITHOUT_QUIET = {
    name: why
    for name, why in WITHOUT_JSON.items()
    if name.split()[1] in ("capture", "completion", "live", "schema")
}


@pytest.mark.parametrize("prog", COMMANDS)
def test_each_command_can_speak_to_programs_and_hardly_at_all(prog: str) -> None:
    """A new command cannot forget it: the list is the parser's, exceptions say why."""
    (leaf,) = (one for one in leaves(parser()) if one.prog == prog)
    options = {option for action in leaf._actions for option in action.option_strings}
    assert ("--json" in options) != (prog in WITHOUT_JSON)
    assert ("--quiet" in options) != (prog in WITHOUT_QUIET)


def test_history_plan_and_batch_in_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = dataset(tmp_path / "data")
    advice = call(capsys, "plan", data, "--depth", 700, "--rows", 2, "--json")
    assert advice.status == 0, advice.err
    told = json.loads(advice.out)
    assert told["depths_mm"] == [700]
    for targets in told["targets"].values():
        assert len(targets) == 2
        assert targets[-1]["u_rel_after"][0] < told["u_rel_now"][0]
    assert call(capsys, "plan", data, "--depth", 700, "--rows", 2, "-q").out == ""

    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "dataset.toml").write_text("format = 1\n")
    batch = call(capsys, "batch", tmp_path / "bad", "--out", tmp_path / "out", "--json")
    assert batch.status == 2
    (line,) = json.loads(batch.out)["datasets"]
    assert (line["dataset"], line["result"]) == (str(tmp_path / "bad"), "refused")
    kept = (tmp_path / "out" / "batch.html").read_bytes()
    none = call(capsys, "batch", tmp_path / "nothing-*", "--out", tmp_path / "out")
    assert (none.status, none.out) == (2, "")
    assert "not there" in none.err
    assert (tmp_path / "out" / "batch.html").read_bytes() == kept

    index = tmp_path / "h.sqlite"
    (tmp_path / "empty").mkdir()
    found = call(capsys, "history", "index", tmp_path / "empty", "--index", index, "--json")
    assert json.loads(found.out)["calibrations"] == 0
    rigs = call(capsys, "history", "show", "--index", index, "--json")
    assert json.loads(rigs.out) == {"rigs": []}


def test_a_run_of_another_seed_is_told_to_be_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    data, out = dataset(tmp_path / "data"), tmp_path / "out"
    out.mkdir()
    (out / "calibration.json").write_text('{"seed": 7}')
    monkeypatch.setattr("calib.cli.calibrate._run_chain", lambda *_, **__: None)
    monkeypatch.setattr("calib.cli.console.summary", lambda _: ("", True))
    told = call(capsys, "calibrate", data, "--out", out, "--seed", 1, "--force")
    assert "holds a run of seed 7; it is replaced" in told.err
    assert "replaced" not in call(capsys, "calibrate", data, "--out", out, "--seed", 7, "-f").err


def test_a_depth_that_was_meant_in_metres_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = dataset(tmp_path / "data")
    told = call(capsys, "plan", data, "--depth", 1.5, "--rows", 1)
    assert "--depth is in mm: 1.5 mm" in told.err
    assert "is in mm" not in call(capsys, "plan", data, "--depth", 900, "--rows", 1).err
