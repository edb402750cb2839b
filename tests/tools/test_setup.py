"""Setting up on machines that lack something. Evidence: property.

The script runs in a copy of the few files it reads, with a PATH that holds only what the machine
under test has. Installing for real is what CI's clean clone does.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2]
BASICS = (
    "bash",
    "env",
    "cat",
    "sha256sum",
    "dirname",
    "grep",
    "printf",
    "mkdir",
    "chmod",
    "flock",
    "sleep",
    "uname",
)

OLD_PYTHON = "#!/bin/sh\nexit 1\n"

NEW_PYTHON = """\
#!/bin/bash
case "$1 $2" in
  "--version "*) echo "Python 3.11.2";;
  "-m venv") mkdir -p "$4/bin"; cp "$0" "$4/bin/python"; echo "VENV" >>pip.log;;
  "-m pip")
      [ "$3" = --version ] && exit 0
      [ -z "$PIP_SAYS" ] || { echo "$PIP_SAYS" >&2; exit 1; }
      : >begun; [ -z "$PIP_TAKES" ] || sleep "$PIP_TAKES"
      echo "PIP $*" >>pip.log
      echo "#!$(pwd -P)/.venv/bin/python" >.venv/bin/calib
      chmod +x .venv/bin/calib;;
esac
"""

APT = '#!/bin/sh\necho "APT $*" >>"$LOG"\nexit {status}\n'


@dataclass
class Machine:
    """A checkout in a folder with an awkward name, and what stands on the PATH."""

    root: Path
    tools: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        (self.root / "tools").mkdir(parents=True)
        for name in ("tools/setup.sh", "requirements.lock", "requirements-dev.lock",
                     "pyproject.toml"):  # fmt: skip
            shutil.copy(PROJECT / name, self.root / name)

    @property
    def log(self) -> str:
        path = self.root / "log"
        return path.read_text() if path.exists() else ""

    @property
    def pip_log(self) -> list[str]:
        path = self.root / "pip.log"
        return path.read_text().splitlines() if path.exists() else []

    def setup(self, level: str = "runtime", **env: str) -> subprocess.CompletedProcess[str]:
        process = self.start(level, **env)
        out, err = process.communicate()
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)

    def start(self, level: str = "runtime", **env: str) -> subprocess.Popen[str]:
        path = self.root / "path"
        shutil.rmtree(path, ignore_errors=True)
        path.mkdir()
        for name in (*BASICS, "cp", "rm", "ls"):
            real = shutil.which(name)
            if real is not None:
                (path / name).symlink_to(real)
        for name, text in self.tools.items():
            (path / name).write_text(text)
            (path / name).chmod(0o755)
        basics = {"PATH": str(path), "LOG": str(self.root / "log"), "HOME": os.environ["HOME"]}
        return subprocess.Popen(
            [path / "bash", self.root / "tools" / "setup.sh", level],
            env=basics | env,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path / "a rig öf ours", {"python3": NEW_PYTHON})


def test_no_apt_is_said_and_not_fatal(machine: Machine) -> None:
    done = machine.setup()
    assert done.returncode == 0, done.stderr
    assert "no apt on this machine" in done.stderr
    assert "python3-mrcal" in done.stderr
    assert (machine.root / ".venv" / ".ready-runtime").exists()
    assert "--require-hashes" in machine.pip_log[1]


def test_second_time_does_nothing(machine: Machine) -> None:
    assert machine.setup().returncode == 0
    before = machine.pip_log
    again = machine.setup()
    assert (again.returncode, again.stdout, again.stderr) == (0, "", "")
    assert machine.pip_log == before


def test_changed_lock_is_installed(machine: Machine) -> None:
    assert machine.setup().returncode == 0
    before = len(machine.pip_log)
    with (machine.root / "requirements.lock").open("a") as lock:
        lock.write("# changed\n")
    assert machine.setup().returncode == 0
    assert len(machine.pip_log) > before


def test_dev_contains_runtime(machine: Machine) -> None:
    assert machine.setup("dev").returncode == 0
    before = machine.pip_log
    assert machine.setup("runtime").returncode == 0
    assert machine.pip_log == before


def test_old_python_is_refused(machine: Machine) -> None:
    script = machine.root / "tools" / "setup.sh"
    # The machine that runs this test may well have a good one there.
    script.write_text(script.read_text().replace(" /usr/bin/python3 ", " "))
    machine.tools = {"python3": OLD_PYTHON}
    done = machine.setup()
    assert done.returncode == 2
    assert "needs Python 3.11 or newer" in done.stderr
    assert not (machine.root / ".venv").exists()


NO_VERSION = "ERROR: Could not find a version that satisfies the requirement numpy==2.4.6"
# What pip says (26.1, quiet), shortened, and what must be said of it.
CAUSES = {
    "no network": (
        "WARNING: connection broken by 'NewConnectionError(Failed to establish a new "
        f"connection: [Errno -3] Temporary failure in name resolution)'\n{NO_VERSION}",
        "is there a network",
    ),
    "full disk": ("ERROR: [Errno 28] No space left on device", "the disk is full"),
    "hash": (
        "ERROR: THESE PACKAGES DO NOT MATCH THE HASHES FROM THE REQUIREMENTS FILE.",
        "a mirror or proxy changed it",
    ),
    "no wheel": (f"{NO_VERSION}\nERROR: No matching distribution found", "Python 3.11 to 3.13"),
    "certificate": (
        f"WARNING: SSLCertVerificationError: certificate verify failed\n{NO_VERSION}", "PIP_CERT",
    ),
    "login": ("ERROR: HTTP error 401 Client Error: Unauthorized for url", "refuses access"),
    "permissions": ("ERROR: [Errno 13] Permission denied: '/x'", "who owns this folder"),
    "something else": ("ERROR: the moon is full", "its words are above"),
}  # fmt: skip


@pytest.mark.parametrize(("words", "said"), CAUSES.values(), ids=CAUSES.keys())
def test_why_pip_failed(words: str, said: str, machine: Machine) -> None:
    done = machine.setup(PIP_SAYS=words)
    assert done.returncode == 2
    assert words in done.stderr
    assert said in done.stderr
    others = [other for _, other in CAUSES.values() if other != said]
    assert [other for other in others if other in done.stderr] == []
    assert not (machine.root / ".venv" / ".ready-runtime").exists()


def test_two_at_once_wait_for_each_other(machine: Machine) -> None:
    """Property: on a fresh clone pip works once; the second finds all done."""
    first = machine.start(PIP_TAKES="1")
    while not (machine.root / "begun").exists():
        assert first.poll() is None, first.communicate()
        time.sleep(0.02)
    second = machine.setup()
    first.communicate()
    assert first.returncode == 0
    assert second.returncode == 0
    assert "another set-up is at work here; waiting for it" in second.stderr
    assert machine.pip_log.count("VENV") == 1
    assert sum(line.startswith("PIP -m pip install") for line in machine.pip_log) == 2


def test_a_killed_set_up_leaves_no_lock(machine: Machine) -> None:
    first = machine.start(PIP_TAKES="3")
    while not (machine.root / "begun").exists():
        time.sleep(0.02)
    first.kill()
    first.communicate()
    done = machine.setup()
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["it's ours", "a # 100% rig", "ein Gerät, groß"])
def test_awkward_paths_work(name: str, tmp_path: Path) -> None:
    """pip's own start scripts were tried in such folders too, by hand."""
    machine = Machine(tmp_path / name, {"python3": NEW_PYTHON})
    assert machine.setup().returncode == 0
    again = machine.setup()
    assert (again.returncode, again.stderr) == (0, "")


@pytest.mark.parametrize("name", ['a "rig"', "a\nrig", "$rig", "a`rig", "a\\rig"])
def test_paths_that_start_scripts_cannot_hold_are_refused_at_once(
    name: str, tmp_path: Path
) -> None:
    machine = Machine(tmp_path / name, {"python3": NEW_PYTHON})
    done = machine.setup()
    assert done.returncode == 2
    assert "move or rename it" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (machine.root / ".venv").exists()


def test_moved_folder_is_set_up_anew(machine: Machine) -> None:
    assert machine.setup().returncode == 0
    moved = machine.root.with_name("elsewhere")
    machine.root.rename(moved)
    machine.root = moved
    assert machine.setup().returncode == 0
    assert machine.pip_log.count("VENV") == 2


def test_missing_packages_without_sudo(machine: Machine) -> None:
    machine.tools |= {
        "apt-get": APT.format(status=0),
        "dpkg-query": "#!/bin/sh\nexit 1\n",
        "id": "#!/bin/sh\necho 1000\n",
    }
    done = machine.setup()
    assert done.returncode == 0, done.stderr
    assert "there is no sudo" in done.stderr
    assert "apt-get install python3-venv python3-mrcal" in done.stderr
    assert "APT" not in machine.log


@pytest.mark.parametrize("status", [0, 100])
def test_missing_packages_with_sudo(machine: Machine, status: int) -> None:
    machine.tools |= {
        "apt-get": APT.format(status=status),
        "dpkg-query": "#!/bin/sh\nexit 1\n",
        "id": "#!/bin/sh\necho 1000\n",
        "sudo": '#!/bin/sh\necho "SUDO" >>"$LOG"\nexec "$@"\n',
    }
    done = machine.setup()
    assert done.returncode == 0, "without these packages the rest still works"
    assert "SUDO" in machine.log
    assert "APT install -y" in machine.log
    assert ("going on without" in done.stderr) is (status != 0)


def test_installed_packages_need_no_apt_run(machine: Machine) -> None:
    machine.tools |= {
        "apt-get": APT.format(status=0),
        "dpkg-query": "#!/bin/sh\necho installed\n",
    }
    assert machine.setup().returncode == 0
    assert "APT" not in machine.log


def test_usage() -> None:
    done = subprocess.run(
        ["bash", PROJECT / "tools" / "setup.sh"], capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert "runtime|dev" in done.stderr
