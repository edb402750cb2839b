"""The audit of the locked packages finds what it is for. Evidence: property."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

PROJECT = Path(__file__).parents[2]
HASH = " \\\n    --hash=sha256:" + "0" * 64


@pytest.fixture(scope="module")
def audit() -> ModuleType:
    spec = importlib.util.spec_from_file_location("audit", PROJECT / "tools" / "audit.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("lock", ["requirements.lock", "requirements-dev.lock"])
def test_the_locks_are_clean(audit: ModuleType, lock: str) -> None:
    text = (PROJECT / lock).read_text()
    assert sum(1 for _ in audit.entries(text)) > 40
    assert list(audit.faults(text)) == []


FAULTS = {
    "numpy>=2" + HASH: "not pinned",
    "numpy @ https://example.org/numpy.whl" + HASH: "not pinned",
    "numpy==2.0.0": "no hashes",
    "numpy==1.0.0" + HASH: "1.0.0 is locked",
    "no-such-package-at-all==1" + HASH: "not installed",
}


@pytest.mark.parametrize(("lock", "said"), FAULTS.items())
def test_fault_is_found(audit: ModuleType, lock: str, said: str) -> None:
    assert any(said in fault for fault in audit.faults(lock))


def test_markers_that_do_not_apply_are_left_alone(audit: ModuleType) -> None:
    assert list(audit.faults("no-such-package==1 ; sys_platform == 'win32'" + HASH)) == []


@pytest.mark.parametrize(
    ("words", "refused"),
    [
        ("GPL-3.0-or-later", True),
        ("AGPL-3.0", True),
        ("License :: OSI Approved :: GNU General Public License v3 (GPLv3)", True),
        ("LGPL-2.1-or-later", False),
        ("License :: OSI Approved :: GNU Lesser General Public License v3 (LGPLv3)", False),
        ("BSD-3-Clause", False),
        ("Apache-2.0 AND MIT", False),
    ],
)
def test_licenses(audit: ModuleType, words: str, refused: bool) -> None:
    assert bool(audit.COPYLEFT.search(words)) is refused


def test_exit_status(audit: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lock = tmp_path / "bad.lock"
    lock.write_text("numpy==1.0.0\n")
    assert audit.main([str(lock)]) == 1
    assert "bad.lock: numpy: no hashes" in capsys.readouterr().err


def test_only_what_is_left_out_on_purpose_may_be_missing(audit: ModuleType) -> None:
    assert audit.left_out("cvxpy 1.9.2 requires scs, which is not installed.")
    assert not audit.left_out("cvxpy 1.9.2 requires numpy, which is not installed.")


def test_what_is_left_out_is_what_the_locks_name(audit: ModuleType) -> None:
    command = (PROJECT / "tools" / "lock.sh").read_text()
    asked = command.partition("for name in ")[2].partition(";")[0].split()
    assert sorted(asked) == sorted(audit.LEFT_OUT)
    for name in audit.LOCKS:
        lock = (PROJECT / name).read_text()
        listed = lock.rpartition("excluded from the output:\n")[2].replace("# ", "").split()
        assert set(listed) == {*asked}
        assert not {requirement.name for requirement, _ in audit.entries(lock)} & {*asked}


def test_the_fit_needs_nothing_of_what_is_left_out(audit: ModuleType) -> None:
    program = (
        f"import sys; sys.modules.update(dict.fromkeys({sorted(audit.LEFT_OUT)}));"
        "import cvxpy; x = cvxpy.Variable(2);"
        "problem = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum(cvxpy.huber(x - 1))));"
        "problem.solve(solver=cvxpy.CLARABEL); assert abs(x.value - 1).max() < 1e-3"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", program], check=True)
