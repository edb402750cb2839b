"""Setting up on machines that lack something. Evidence: property.

The script runs in a copy of the few files it reads, with a PATH that holds only what the machine
under test has. Installing for real is what CI's clean clone does.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2]
BASICS = ("bash", "env", "cat", "sha256sum", "dirname", "grep", "printf", "mkdir", "chmod")

OLD_PYTHON = "#!/bin/sh\nexit 1\n"

NEW_PYTHON = """\
#!/bin/bash
case "$1 $2" in
  "--version "*) echo "Python 3.11.2";;
  "-m venv") mkdir -p "$4/bin"; cp "$0" "$4/bin/python"; echo "VENV" >>pip.log;;
  "-m pip")
      [ "$3" = --version ] && exit 0
      [ -z "$NO_NETWORK" ] || exit 1
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

    def setup(self, level: str = "runtime") -> subprocess.CompletedProcess[str]:
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
        return subprocess.run(
            [path / "bash", self.root / "tools" / "setup.sh", level],
            env={"PATH": str(path), "LOG": str(self.root / "log"), "HOME": os.environ["HOME"]},
            capture_output=True,
            text=True,
            check=False,
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


def test_no_network(machine: Machine) -> None:
    machine.tools["python3"] = NEW_PYTHON.replace('"$NO_NETWORK"', "yes")
    done = machine.setup()
    assert done.returncode == 2
    assert "is there a network" in done.stderr
    assert not (machine.root / ".venv" / ".ready-runtime").exists()


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
