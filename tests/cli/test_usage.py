"""Bad usage and bad datasets at the command line: status 2, one message, nothing written.

Evidence: property (exit status and message are a contract with scripts and people). Every kind of
fault by itself is tested in tests/dataset; here is what reaches the user.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from command import CALIB, DATASETS, GOOD, call, dataset, process, tree

from calib.cli.main import main

HEAVY = {"numpy", "cv2", "scipy", "matplotlib", "h5py", "pydantic", "emcee", "cvxpy", "tqdm"}


@pytest.mark.parametrize(
    "arguments", [["--help"], ["--version"], ["calibrate", "--help"], ["measure", "-h"], ["chek"]]
)
def test_help_imports_nothing_heavy(arguments: list[str]) -> None:
    code = (
        "import sys\n"
        "from calib.cli.main import main\n"
        "try:\n"
        "    main(sys.argv[1:])\n"
        "except SystemExit:\n"
        "    pass\n"
        "print('LOADED', *sorted({name.split('.')[0] for name in sys.modules}))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split("LOADED")[1].split())
    assert "calib" in loaded
    assert not loaded & HEAVY


def test_check_of_tables_loads_no_image_library() -> None:
    code = (
        "import sys; from calib.cli.main import main\n"
        f"assert main(['check', {str(DATASETS / 'xu-wang-2017')!r}]) == 0\n"
        "print('LOADED', *sorted({name.split('.')[0] for name in sys.modules}))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"cv2", "scipy", "matplotlib", "cvxpy"} & set(done.stdout.split())


USAGE = {
    "no command": [],
    "unknown command": ["chek", "x"],
    "no dataset": ["calibrate"],
    "unknown option": ["check", "x", "--fast"],
    "seed is a word": ["calibrate", "DATA", "--seed", "one"],
    "seed below 0": ["calibrate", "DATA", "--seed", "-1"],
    "seed too large": ["calibrate", "DATA", "--seed", str(2**63)],
    "depths the wrong way round": ["calibrate", "DATA", "--out", "OUT", "--depths", "900", "400"],
    "depths of NaN": ["calibrate", "DATA", "--out", "OUT", "--depths", "nan", "nan"],
    "depths without end": ["calibrate", "DATA", "--out", "OUT", "--depths", "1", "inf"],
    "depths beyond the world": ["calibrate", "DATA", "--out", "OUT", "--depths", "500", "1e30"],
    "plan beyond the world": ["plan", "DATA", "--depth", "1e30"],
    "simulate a billion rows": ["simulate", "OUT", "--seed", "1", "--rows", "1000000000"],
    "simulate to the stars": ["simulate", "OUT", "--seed", "1", "--set", "baseline_mm=1e308"],
    "simulate nothing known": ["simulate", "OUT", "--seed", "1", "--set", "baseline_mm=nan"],
    "study for ever": ["study", "--out", "OUT", "--rigs", "1000000000000"],
    "study on a crowd": ["study", "--out", "OUT", "--rigs", "1", "--jobs", "100000000"],
    "rigs in powers of ten": ["study", "--out", "OUT", "--rigs", "1e12"],
    "dataset of no text": ["calibrate", "a\udcff", "--out", "OUT"],
    "out of no text": ["calibrate", "DATA", "--out", "OUT\udcfe"],
    "no such dataset": ["calibrate", "MISSING", "--out", "OUT"],
    "dataset is a file": ["check", "DATA/gaze.csv"],
    "out is a file": ["calibrate", "DATA", "--out", "DATA/gaze.csv"],
    "out below a file": ["calibrate", "DATA", "--out", "DATA/gaze.csv/out"],
    "no calibration": ["measure", "MISSING", "DATA/gaze.csv"],
    "calibration is a table": ["measure", "DATA/gaze.csv", "DATA/gaze.csv"],
    "simulate without a seed": ["simulate", "OUT"],
    "simulate over something": ["simulate", "DATA", "--seed", "1"],
    "simulate an unknown model": ["simulate", "OUT", "--seed", "1", "--model", "best"],
    "simulate an unknown parameter": ["simulate", "OUT", "--seed", "1", "--set", "baseline=9"],
    "simulate twice": ["simulate", "OUT", "--seed", "1", *["--set", "delta2_rad=0.01"] * 2],
    "simulate a point": ["simulate", "OUT", "--seed", "1", "--images", "--set", "baseline_mm=1e-3"],
    "depths of nothing": ["calibrate", "DATA", "--out", "OUT", "--depths", "1e-300", "1e-299"],
    "simulate a word": ["simulate", "OUT", "--seed", "1", "--set", "baseline_mm=long"],
    "simulate without rows": ["simulate", "OUT", "--seed", "1", "--rows", "0"],
    "simulate negative rows": ["simulate", "OUT", "--seed", "1", "--rows", "-3"],
    "simulate only outliers": ["simulate", "OUT", "--seed", "1", "--outliers", "2"],
}


@pytest.mark.parametrize("arguments", USAGE.values(), ids=USAGE.keys())
def test_bad_usage(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dataset(tmp_path / "data")
    places = {"DATA": "data", "OUT": "out", "MISSING": "missing"}
    for word, name in places.items():
        arguments = [a.replace(word, str(tmp_path / name)) for a in arguments]
    before = tree(tmp_path)
    ended = call(capsys, *arguments)
    assert ended.status == 2
    assert ended.out == ""
    assert len(ended.err.splitlines()) == 1
    assert "Traceback" not in ended.err
    assert "_seed" not in ended.err, "names the program's insides"
    assert tree(tmp_path) == before


ROW = "2,0.2635,0.0100,95.006,486.5"

# File, what is replaced in it, by what, and what the message must hold.
BAD = {
    "unknown key": ("dataset.toml", "u_x1c", "u_xc1", ["dataset.toml", "u_xc1", "u_x1c"]),
    "unknown section": ("dataset.toml", "[encoder]", "[encodr]", ["encodr", "encoder"]),
    "missing key": ("dataset.toml", "resolution_deg = 0.05625", "", ["resolution_deg"]),
    "wrong type": ("dataset.toml", "0.05625", '"fine"', ["dataset.toml", "resolution_deg"]),
    "not TOML": ("dataset.toml", "[gaze]", "[gaze", ["dataset.toml", "line"]),
    "another format": ("dataset.toml", "format = 1", "format = 2", ["dataset.toml", "format"]),
    "negative uncertainty": ("dataset.toml", "0.0002", "-0.0002", ["u_x1c"]),
    "infinite uncertainty": ("dataset.toml", "0.0002", "inf", ["u_x1c"]),
    "table that is not there": ("dataset.toml", '"gaze.csv"', '"gase.csv"', ["gase.csv"]),
    "table outside": ("dataset.toml", '"gaze.csv"', '"../gaze.csv"', ["dataset.toml", ".."]),
    "prior of no parameter": (
        "dataset.toml",
        "[gaze]",
        "[priors]\naxis_zz_mm = [0, 20]\n[gaze]",
        ["axis_zz_mm", "axis_z_mm"],
    ),
    "unknown column": ("gaze.csv", "alpha2_deg", "alpha_deg", ["gaze.csv", "line 1", "alpha2_deg"]),
    "no id column": ("gaze.csv", "id,", "group,", ["gaze.csv", "id"]),
    "repeated id": ("gaze.csv", ROW, ROW.replace("2", "1", 1), ["gaze.csv", "line 3", "id"]),
    "word": ("gaze.csv", "486.5", "near", ["gaze.csv", "line 3", "z_mm", "near"]),
    "NaN": ("gaze.csv", "486.5", "nan", ["gaze.csv", "line 3", "z_mm", "nan"]),
    "infinity": ("gaze.csv", "0.2635", "inf", ["gaze.csv", "line 3", "x1c", "inf"]),
    "empty cell": ("gaze.csv", "0.2635", "", ["gaze.csv", "line 3", "x1c"]),
    "cell too few": ("gaze.csv", ROW, "2,0.2635,0.01,95.006", ["gaze.csv", "line 3"]),
    "decimal comma": ("gaze.csv", "486.5", '"486,5"', ["gaze.csv", "line 3", "decimal"]),
    "semicolons": ("gaze.csv", ",", ";", ["gaze.csv", "semicolon"]),
    "radians": ("gaze.csv", "95.006", "1.6582", ["gaze.csv", "line 3", "alpha2_deg"]),
    "reading outside": ("gaze.csv", "95.006", "181", ["gaze.csv", "line 3", "alpha2_deg"]),
    "depth of 0": ("gaze.csv", "486.5", "0", ["gaze.csv", "line 3", "z_mm"]),
    "depth below 0": ("gaze.csv", "486.5", "-486.5", ["gaze.csv", "line 3", "z_mm"]),
    "depth in metres": ("gaze.csv", "486.5", "0.4865", ["gaze.csv", "line 3", "z_mm", "unit"]),
    "pixels for x1c": ("gaze.csv", "0.2635", "312.4", ["gaze.csv", "line 3", "x1c", "u1_px"]),
    "stem of no pair": (
        "gaze.csv",
        "z_mm\n",
        "stereo\n",
        ["gaze.csv", "stereo"],
    ),
    "no rows": ("gaze.csv", GOOD["gaze.csv"], "id,x1c,y1c,alpha2_deg,z_mm\n", ["gaze.csv", "row"]),
    "empty file": ("gaze.csv", GOOD["gaze.csv"], "", ["gaze.csv", "empty"]),
}


@pytest.mark.parametrize("command", ["check", "calibrate"])
@pytest.mark.parametrize(("file", "old", "new", "said"), BAD.values(), ids=BAD.keys())
def test_bad_dataset(
    file: str,
    old: str,
    new: str,
    said: list[str],
    command: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert old in GOOD[file]
    data = dataset(tmp_path / "data", GOOD | {file: GOOD[file].replace(old, new)})
    before = tree(tmp_path)
    place = ["--out", tmp_path / "out"] if command == "calibrate" else []
    ended = call(capsys, command, data, *place)
    assert ended.status == 2
    assert ended.out == ""
    message = next(line for line in ended.err.splitlines() if all(s in line for s in said))
    assert "; " in message, "a message ends with its remedy"
    assert tree(tmp_path) == before
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "bytes_", [b"\xff\xfei\x00d\x00", "id,x1c\n1,\xe9".encode("latin-1"), b"id,x1c\n\x00\x01"]
)
def test_table_of_other_bytes(
    bytes_: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = dataset(tmp_path / "data", GOOD | {"gaze.csv": bytes_})
    ended = call(capsys, "check", data)
    assert ended.status == 2
    assert "gaze.csv" in ended.err


def test_all_problems_at_once_in_a_process_of_its_own(tmp_path: Path) -> None:
    table = GOOD["gaze.csv"].replace("486.5", "near").replace("95.006", "181")
    manifest = GOOD["dataset.toml"].replace("u_x1c", "u_xc1")
    data = dataset(tmp_path / "da tä", {"dataset.toml": manifest, "gaze.csv": table})
    ended = process("calibrate", data, "--out", tmp_path / "out")
    assert ended.status == 2
    assert ended.out == ""
    for said in ("u_xc1", "near", "181"):
        assert said in ended.err
    assert "Traceback" not in ended.err
    assert not (tmp_path / "out").exists()


def test_reader_that_goes_away_is_no_error() -> None:
    command = f"set -o pipefail; '{CALIB}' check '{DATASETS / 'xu-wang-2017'}' | head -c 0"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    assert done.returncode in (0, 141)


def test_console_script_and_module_are_the_same() -> None:
    asked = [sys.executable, "-m", "calib", "--version"]
    module = subprocess.run(asked, capture_output=True, text=True, check=True)
    assert process("--version").out == module.stdout
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0


def test_an_empty_name_is_not_the_working_directory(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What `--out "$OUT"` says where OUT is not set."""
    data = dataset(tmp_path / "data", GOOD)
    monkeypatch.chdir(tmp_path)
    before = tree(tmp_path)
    for arguments in (("calibrate", str(data), "--out", ""), ("check", "")):
        with pytest.raises(SystemExit) as ended:
            main(list(arguments))
        assert ended.value.code == 2
        assert "is empty: give a name" in capsys.readouterr().err
    assert tree(tmp_path) == before
