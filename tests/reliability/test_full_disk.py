"""A disk that is full or may not be written: status 2, a clear word, nothing half-written.

Evidence: property. The disk is full by the kernel's word: a limit on the size of files, at which
write(2) fails as it does on a full disk; or, by patching, with ENOSPC itself.
"""

from __future__ import annotations

import errno
import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from short_chain import dataset

from calib.cli.main import main
from calib.core.errors import UsageError
from calib.stages import store
from calib.stages.owner import OWNER
from calib.stages.stage_file import is_intact

LIMITED = """\
import resource, sys
import short_chain
from calib.cli.main import main
short_chain.shorten(setattr)
limit = int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
sys.exit(main(sys.argv[2:]))
"""


def limited(limit: int, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run calib where no file can be longer than `limit` bytes."""
    command = [sys.executable, "-c", LIMITED, str(limit), *map(str, arguments)]
    return subprocess.run(
        command, cwd=Path(__file__).parent, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("limit", [0, 300, 6_000, 60_000])
def test_full_disk(limit: int, tmp_path: Path) -> None:
    data, out = dataset(tmp_path / "data"), tmp_path / "out"
    done = limited(limit, "calibrate", data, "--out", out)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    message = done.stderr.splitlines()[-1]
    assert message.startswith("calib: ")
    assert "cannot be written" in message
    assert "free space or choose another folder" in message
    names = [p for p in out.rglob("*") if p.is_file() and p.name != ".lock"]
    assert not [p for p in names if p.suffix == ".part"]
    for path in names:
        content = path.read_bytes()
        if path == out / OWNER:
            assert json.loads(content)["folder"]  # the record of whose run it is: whole too
            continue
        fingerprint = content.splitlines()[1].decode()
        assert is_intact(path, fingerprint), path
    assert all(p.parent.name == ".stages" for p in names)


def test_measure_on_a_full_disk(tmp_path: Path) -> None:
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY
    (tmp_path / "t.csv").write_text("id,x1c,y1c,alpha2_deg\n" + "a,0,0,85\n")
    calibration = tmp_path / "c.json"
    spread = {"normal": 0.0, "width": 0.0}
    quantities = ("x1c", "y1c", "alpha2_rad", "gaze_residual_rad")
    measurement = {
        "model": "base",
        "names": ["baseline_mm", "delta2_rad"],
        "values": [77.0, 0.013],
        "covariance": [[1.0, 0.0], [0.0, 1e-8]],
        "reading": dict.fromkeys(quantities, spread),
        "stated": {"u_x1c": 1e-4, "encoder_step_rad": 1e-3, "u_alpha2_rad": 0.0},
        "noise_factor": 1.0,
        "calibrated_depth_mm": [500, 1000],
        "factor95": 2.0,
    }
    calibration.write_text(json.dumps({"format": 1, "measurement": measurement}))
    arguments = ("measure", calibration, tmp_path / "t.csv", "--out", tmp_path / "o.csv")
    done = limited(20, *arguments)
    assert done.returncode == 2, done.stderr
    assert "o.csv: cannot be written" in done.stderr
    assert not (tmp_path / "o.csv").exists()
    assert limited(2000, *arguments).returncode == 0
    assert (tmp_path / "o.csv").exists()


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO])
def test_errors_of_the_disk_have_a_clear_word(
    code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(code, os.strerror(code))

    (tmp_path / "there").write_bytes(b"old")
    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(UsageError, match=os.strerror(code)) as caught:
        store.write_bytes(tmp_path / "there", b"new")
    assert caught.value.exit_status == 2
    assert (tmp_path / "there").read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["there"]


@pytest.mark.parametrize("place", ["/proc/calib", "/sys/calib", "/dev/null/calib"])
def test_folder_that_nobody_may_write(
    place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Root may write a folder that is marked read-only; these refuse even root.
    assert main(["calibrate", str(dataset(tmp_path / "data")), "--out", place]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"calib: {place}: cannot be written")
    assert len(said.splitlines()) == 1


def test_read_only_files_in_a_folder_that_may_be_written(tmp_path: Path) -> None:
    target = tmp_path / "calibration.json"
    target.write_bytes(b"old")
    target.chmod(0o444)
    store.write_bytes(target, b"new")
    assert target.read_bytes() == b"new"


def test_lock_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / store.LOCK).mkdir()
    folder = store.Store(tmp_path)
    with pytest.raises(UsageError, match="cannot be written"), folder.locked():
        pytest.fail("it is locked by nobody")
