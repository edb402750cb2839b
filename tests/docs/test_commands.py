"""Every command shown in the documents runs.

Evidence: property. The blocks marked ``sh`` of a document are one script, run in a folder of its
own that holds the datasets. `make` only says what it would do, and calib then does it; chains are
short (see tests/reliability/short_chain.py) but where the tutorial is run as printed.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2]
DOCUMENTS = sorted([PROJECT / "README.md", PROJECT / "datasets" / "README.md",
                    *(PROJECT / "docs").glob("*.md")])  # fmt: skip
BLOCK = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?!https?://|#)([^)#]+)\)")
WITH_COMMANDS = [d for d in DOCUMENTS if BLOCK.search(d.read_text())]

PROGRAM = """\
import sys
if {short}:
    sys.path.insert(0, {folder!r})
    import short_chain
    short_chain.shorten(setattr)
from calib.cli.main import main
sys.exit(main())
"""

# A shebang holds no path with spaces.
CALIB = """\
#!/bin/sh
exec '{python}' '{program}' "$@"
"""

MAKE = """\
#!/bin/bash
set -e
{make} --no-print-directory -C {project} -n "$@" > plan.txt
grep -q . plan.txt
[ "$1" = calibrate ] || exit 0
calib calibrate "${{2#DATA=}}" --out "reports/$(basename "$2")"
"""


def script(document: Path) -> str:
    return "\n".join(BLOCK.findall(document.read_text()))


def run(document: Path, folder: Path, *, short: bool) -> str:
    """Run a document's commands in `folder`; return what they say."""
    shutil.copytree(PROJECT / "datasets" / "xu-wang-2017", folder / "datasets" / "xu-wang-2017")
    tools = folder / ".venv" / "bin"
    tools.mkdir(parents=True)
    (tools / "activate").touch()
    make = shutil.which("make")
    assert make is not None
    texts = {
        "program.py": PROGRAM.format(short=short, folder=str(PROJECT / "tests" / "reliability")),
        "calib": CALIB.format(python=sys.executable, program=tools / "program.py"),
        "make": MAKE.format(make=make, project=f"'{PROJECT}'"),
    }
    for name, text in texts.items():
        (tools / name).write_text(text)
        (tools / name).chmod(0o755)
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script(document)],
        cwd=folder,
        env=os.environ | {"PATH": f"{tools}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


TUTORIAL = PROJECT / "docs" / "tutorial.md"
RUNS = [d if d == TUTORIAL else pytest.param(d, marks=pytest.mark.slow) for d in WITH_COMMANDS]


@pytest.mark.parametrize("document", RUNS, ids=lambda d: str(d.relative_to(PROJECT)))
def test_commands_run(document: Path, tmp_path: Path) -> None:
    said = run(document, tmp_path, short=True)
    if "calib measure" in script(document):
        assert "x_mm,y_mm,z_mm,u_x_mm" in said


def test_there_are_commands_to_run() -> None:
    assert {d.name for d in WITH_COMMANDS} >= {"README.md", "tutorial.md"}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda d: str(d.relative_to(PROJECT)))
def test_links_lead_somewhere(document: Path) -> None:
    for link in LINK.findall(document.read_text()):
        assert (document.parent / link).exists(), link


PUBLISHED = sorted(p for p in (PROJECT / "docs").rglob("*") if p.suffix in (".md", ".json", ".csv"))


@pytest.mark.parametrize("document", PUBLISHED, ids=lambda d: str(d.relative_to(PROJECT)))
def test_no_folder_of_one_machine_is_named(document: Path) -> None:
    assert not re.search(r"(?<![\w./])/(tmp|home|root|work|Users)/", document.read_text())


PARAMETER = re.compile(r"^  (\w+) +(-?[\d.e+-]+) \+- ([\d.e+-]+)", re.MULTILINE)


@pytest.mark.slow
def test_tutorial_prints_what_the_program_says(tmp_path: Path) -> None:
    found = PARAMETER.findall(run(TUTORIAL, tmp_path, short=False))
    said = {name: (float(value), float(std)) for name, value, std in found}
    printed = PARAMETER.findall(TUTORIAL.read_text())
    assert len(printed) >= 4
    for name, value, std in printed:
        # Chains of another machine may differ in the last bit and then walk apart: a twentieth of
        # a standard uncertainty is the noise of 4,000 draws with room to spare.
        assert abs(float(value) - said[name][0]) < 0.05 * said[name][1], name
        assert float(std) == pytest.approx(said[name][1], rel=0.1), name
