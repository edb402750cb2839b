"""`calib plan` on tables, on images, on a rig without rows.

Evidence: properties of the printed advice; simulated truth behind the rig with images.
"""

from __future__ import annotations

import argparse
import csv
import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from seen_rig import CAMERA, STEREO, THETA, seen_rig

from calib.cli.main import main
from calib.cli.plan import add_arguments, run
from calib.core.errors import EstimationError, UsageError
from calib.dataset.contents import Dataset
from calib.dataset.load import load_dataset
from calib.fit.priors import MeasuredParameters
from calib.plan.prepare import prepare
from calib.plan.prior_knowledge import PriorKnowledge, from_images
from calib.stages.store import Store

ROOT = Path(__file__).parents[2]
DATA = str(ROOT / "datasets" / "xu-wang-2017")


def plan(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return run(parser.parse_args(arguments))


def test_plan_prints_ranked_targets_and_draws_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, head in (("plan.svg", b"<?xml"), ("plan.png", b"\x89PNG")):
        out = tmp_path / name
        assert plan(DATA, "--depth", "500", "1020", "--rows", "4", "--out", str(out)) == 0
        assert out.read_bytes().startswith(head)
    lines = capsys.readouterr().out.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("G-optimal"))
    table = [[float(x) for x in line.split()] for line in lines[start + 2 : start + 6]]
    assert [row[0] for row in table] == [1, 2, 3, 4]
    now = [float(x) for x in next(line for line in lines if line.startswith("now")).split()[1:]]
    assert table[0][-1] < now[-1]
    assert all(a[-1] >= b[-1] for a, b in pairwise(table))
    assert all(40 <= row[5] <= 140 for row in table)


def test_advice_from_rows_that_contradict_each_other_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Simulated truth: 3 of 12 reference depths too long by 6 %."""
    data = tmp_path / "rig"
    assert main(["simulate", str(data), "--seed", "3", "--rows", "12", "--quiet"]) == 0
    asked = ("--depth", "1500", "--rows", "2")
    assert plan(str(data), *asked) == 0
    table = data / "gaze.csv"
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in (rows[1], rows[4], rows[9]):
        row["z_mm"] = str(1.06 * float(row["z_mm"]))
    with table.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    capsys.readouterr()
    assert plan(str(data), *asked, "--json") == 3
    told = capsys.readouterr()
    assert [gate["name"] for gate in json.loads(told.out)["failed_gates"]] == ["residuals"]
    assert "gate residuals FAILED" in told.err
    assert "targets rest on what failed" in told.err
    assert plan(str(data), *asked, "--quiet", "--accept-failed") == 0
    assert capsys.readouterr().err == ""


def test_rows_all_on_one_side_of_the_axis_can_be_planned_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without C1 the advice stays among the rows, here all at one height below C1's axis."""
    rows = "1,0.10,0.01,86.15,485.9\n2,0.26,0.01,95.01,486.5\n3,0.24,0.01,96.95,796.4\n"
    rows += "4,0.02,0.01,85.21,805.9\n5,0.02,0.01,85.86,1008.5\n6,0.16,0.01,94.03,998.5\n"
    (tmp_path / "gaze.csv").write_text("id,x1c,y1c,alpha2_deg,z_mm\n" + rows)
    (tmp_path / "dataset.toml").write_text(
        'format = 1\nname = "low"\n[encoder]\nresolution_deg = 0.05625\n'
        '[gaze]\ntable = "gaze.csv"\nu_x1c = 0.003\nu_z_rel = 0.002\n'
    )
    assert plan(str(tmp_path), "--depth", "800", "--rows", "2") == 0
    said = capsys.readouterr().out
    start = said.index("G-optimal")
    for line in said[start:].splitlines()[2:4]:
        _, _, y, z, *_ = map(float, line.split())
        assert y == pytest.approx(0.01 * z, abs=0.5)


def test_same_seed_same_picture(tmp_path: Path) -> None:
    pictures = []
    for name in ("a.svg", "b.svg"):
        plan(DATA, "--depth", "800", "--rows", "2", "--out", str(tmp_path / name))
        pictures.append((tmp_path / name).read_bytes())
    assert pictures[0] == pictures[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--depth", "800", "--out", "plan.gif"], "svg"),
        (["--depth", "800", "--model", "round"], "axis-offset"),
        (["--depth", "800", "--yaw", "40", "41"], "--yaw"),
        (["--depth", "800", "--run", "reports"], "no images"),
        (["--depth", "800", "--targets", "0.1", "0.2"], "--targets"),
    ],
)
def test_wrong_use_is_explained(arguments: list[str], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        plan(DATA, *arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--depth", "far"], "'far': give a depth in mm"),
        (["--depth", "800", "--yaw", "20", "190"], "'190': give an angle"),
        (["--depth", "800", "--rows", "0"], "'0': give a whole number from 1"),
        (["--depth", "800", "--seed", "-1"], "give a whole number from 0"),
    ],
)
def test_wrong_numbers_end_with_status_2(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["plan", DATA, *arguments])
    assert ended.value.code == 2
    assert message in capsys.readouterr().err


def figures(said: str, name: str) -> list[float]:
    """Return the u(z) of a line of the summary."""
    line = next(line for line in said.splitlines() if line.startswith(name))
    return [float("inf") if word == "unknown" else float(word) for word in line.split()[-2:]]


def test_rows_from_images_come_by_the_stages_of_calibrate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The advice stays within C1's image, beats random targets, and nothing is made twice."""
    monkeypatch.chdir(tmp_path)
    folder = seen_rig(tmp_path / "seen")
    asked = ["--depth", "1000", "2000", "--rows", "3"]
    assert main(["plan", str(folder), *asked]) == 0
    first = capsys.readouterr()
    assert "10 rows so far" in first.out
    assert "note: errors that all rows share" in first.out
    now, random, best = (max(figures(first.out, n)) for n in ("now", "3 random", "3 G-opt."))
    assert best < random < now
    edge = float(CAMERA.matrix[0, 2] / CAMERA.matrix[0, 0])
    start = first.out.index("G-optimal targets")
    targets = [line.split() for line in first.out[start:].splitlines()[2:5]]
    assert [row[0] for row in targets] == ["1", "2", "3"]
    assert all(abs(float(row[4])) < edge for row in targets)
    made = {p.name for p in (tmp_path / "reports" / "seen" / ".stages").iterdir()}
    assert "observations.h5" in made
    assert "stereo.h5" in made
    assert "stereo" in first.err
    assert main(["plan", str(folder), *asked, "--run", "reports/seen"]) == 0
    again = capsys.readouterr()
    assert again.out == first.out
    assert again.err == ""


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> tuple[Dataset, PriorKnowledge]:
    folder = tmp_path_factory.mktemp("rig")
    dataset = load_dataset(seen_rig(folder / "seen"))
    return dataset, from_images(dataset, Store(folder / "out"))


def test_rows_from_images_are_those_of_the_rig(seen: tuple[Dataset, PriorKnowledge]) -> None:
    """Simulated truth: baseline, depths and field of the start are the rig's own.

    L_b + e of ten rows is known to a millimetre or two; depths to NOISE_PX / f z² / L_b, 1 mm.
    """
    dataset, prior_knowledge = seen
    assert prior_knowledge.rows is not None
    np.testing.assert_allclose(prior_knowledge.rows.z_mm, np.linspace(700, 1600, 10), atol=5)
    start = prepare(
        dataset, prior_knowledge, model="axis-offset", asked_mm=np.array([1000.0]),
        targets_mm=None, yaw_deg=(40.0, 140.0),
    )  # fmt: skip
    theta = start.knowledge.theta
    assert theta[0] + theta[3] == pytest.approx(THETA[0] + THETA[3], abs=5)
    assert start.field.half_height_c2 == pytest.approx(0.95 * 479 / 1000, rel=1e-3)
    # The uncertainty of stereo grows with the square of depth, and so it is taken to go on.
    near, far = start.noise.of_depth(np.array([1000.0, 2000.0]))
    assert far / near == pytest.approx(4, rel=1e-12)
    own = prior_knowledge.rows.std[:, 4]
    np.testing.assert_allclose(start.noise.of_depth(prior_knowledge.rows.z_mm), own, rtol=0.5)


def test_the_sweep_is_part_of_what_is_known(seen: tuple[Dataset, PriorKnowledge]) -> None:
    """Property: e is then known as well as the sweep knows it, or better."""
    dataset, bare = seen
    measured = MeasuredParameters(("eccentricity_mm",), np.array([3.0]), np.array([[0.1**2]]))
    known = [
        prepare(
            dataset, prior_knowledge, model="axis-offset", asked_mm=np.array([1000.0]),
            targets_mm=None, yaw_deg=(40.0, 140.0),
        ).knowledge
        for prior_knowledge in (bare, PriorKnowledge(bare.rows, bare.cameras, measured))
    ]  # fmt: skip
    alone, swept = (np.sqrt(np.linalg.inv(k.information)[3, 3]) for k in known)
    assert alone > 0.3
    assert swept < 0.1
    assert known[1].theta[3] == pytest.approx(3.0, abs=0.3)


def test_run_of_another_dataset_is_left_alone(tmp_path: Path) -> None:
    folder = seen_rig(tmp_path / "seen")
    out = tmp_path / "out"
    out.mkdir()
    (out / "calibration.json").write_text('{"dataset": {"name": "other"}, "seed": 0}')
    with pytest.raises(UsageError, match="holds a run of 'other'"):
        plan(str(folder), "--depth", "1000", "--run", str(out))
    (out / "calibration.json").write_text("[]")
    with pytest.raises(UsageError, match="name another folder with --run"):
        plan(str(folder), "--depth", "1000", "--run", str(out))
    assert [p.name for p in (out / ".stages").iterdir()] == []


def test_images_without_any_pair_are_no_answer(tmp_path: Path) -> None:
    """Exit status 3, with the reason: the stereo pairs show nothing to the second camera."""
    folder = seen_rig(tmp_path / "seen")
    cache = (folder / "corners.vnl").read_text()
    kept = [line for line in cache.splitlines() if not line.startswith("stereo/c2/")]
    empty = [f"stereo/c2/g{i:02d}.png - - -" for i in range(10)]
    (folder / "corners.vnl").write_text("\n".join([*kept, *empty]) + "\n")
    with pytest.raises(EstimationError) as raised:
        plan(str(folder), "--depth", "1000", "--run", str(tmp_path / "out"))
    assert raised.value.exit_status == 3


def test_rig_without_rows_is_planned_from_its_images(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Baseline from the stereo reference, field of view from the cameras, noise assumed."""
    folder = seen_rig(tmp_path / "seen", sections=STEREO)
    out = ["--run", str(tmp_path / "out")]
    assert plan(str(folder), "--depth", "1000", "2000", "--rows", "6", *out) == 0
    said = capsys.readouterr().out
    assert "no rows so far" in said
    assert "note: no [gaze] in dataset.toml: u(x1c) = 0.0002" in said
    assert figures(said, "now") == [float("inf")] * 2
    assert max(figures(said, "6 G-opt.")) < max(figures(said, "6 random")) < float("inf")


BARE = """\
format = 1
name = "new"
[encoder]
resolution_deg = 0.05625
"""

LOOKS = """\
[cameras.c1]
image_size = [720, 576]
matrix = [[420, 0, 360], [0, 420, 288], [0, 0, 1]]
"""

RULER = "[priors]\nbaseline_mm = [80, 5]\n"


def manifest(folder: Path, text: str) -> str:
    folder.mkdir()
    (folder / "dataset.toml").write_text(text)
    return str(folder)


def test_manifest_alone_can_be_planned_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = manifest(tmp_path / "new", BARE + LOOKS + RULER)
    picture = tmp_path / "plan.svg"
    asked = ["--depth", "800", "1000", "--targets", "400", "1500", "--rows", "5"]
    assert plan(data, *asked, "--out", str(picture)) == 0
    said = capsys.readouterr().out
    assert "no rows so far" in said
    assert "targets from 400 to 1500 mm, readings from 40 to 140 deg" in said
    assert figures(said, "now") == [float("inf")] * 2
    assert max(figures(said, "5 G-opt.")) < 20
    assert picture.read_bytes().startswith(b"<?xml")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["new", "plan.svg"]


@pytest.mark.parametrize(
    ("text", "arguments", "message"),
    [
        (BARE + LOOKS, ["--targets", "400", "1500"], "prior of baseline_mm"),
        (BARE + RULER, ["--targets", "400", "1500"], "where C1 looks"),
        (BARE + LOOKS + RULER, [], "--targets NEAR FAR"),
        ('format = 1\nname = "new"\n' + LOOKS + RULER, [], "resolution_deg"),
    ],
)
def test_what_a_manifest_lacks_is_named(
    text: str, arguments: list[str], message: str, tmp_path: Path
) -> None:
    data = manifest(tmp_path / "new", text)
    with pytest.raises(UsageError, match=message):
        plan(data, "--depth", "1000", *arguments)


TABLE = """\
id, x1c, y1c, alpha2_deg, z_mm
1,0.1018,0.0100,86.150,485.9
2,0.2635,0.0100,95.006,486.5
3,0.2353,0.0100,96.950,796.4
"""


@pytest.mark.parametrize(("rows", "said"), [(0, "no rows"), (1, "1 row "), (3, "3 rows")])
def test_the_first_rows_can_be_planned(
    rows: int, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Too few rows to calibrate, or a header alone: [gaze] says how uncertain rows will be."""
    data = manifest(
        tmp_path / "new", BARE + '[gaze]\ntable = "gaze.csv"\nu_z_rel = 0.003\n' + LOOKS + RULER
    )
    lines = TABLE.splitlines(keepends=True)
    (Path(data) / "gaze.csv").write_text("".join(lines[: 1 + rows]))
    assert plan(data, "--depth", "900", "1000", "--targets", "400", "1500", "--rows", "4") == 0
    out = capsys.readouterr().out
    assert f"model axis-offset, {said}" in out
    assert ("note: too little for axis-offset yet" in out) == (rows > 0)
    assert "assumed" not in out
    assert max(figures(out, "4 G-opt.")) < max(figures(out, "4 random"))
