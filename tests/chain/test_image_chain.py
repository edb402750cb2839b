"""The whole chain on a rendered rig. Evidence: simulated truth, negative controls."""

from __future__ import annotations

import html
import re
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import tomli_w
from chain_runs import Chain, run_chain
from dcc_schema import checked, shares, sources
from scipy.stats import chi2

import calib
from calib.cli.console import summary, summary_json
from calib.core.errors import InputError
from calib.dataset.readers import read_measurements
from calib.instrument.by_model import measure_by
from calib.instrument.calibration_file import read_calibration
from calib.report.numbers import plus_minus
from calib.simulate.contents import IntrinsicViews, SimulationOptions, SweepPlan
from calib.simulate.dataset import simulate_dataset
from tests.reliability.short_chain import leave_out_pages

OPTIONS = SimulationOptions(
    seed=5,
    images=True,
    rows=8,
    validation_rows=8,
    fixed={"baseline_mm": 150.0, "axis_z_mm": -18.0, "eccentricity_mm": 6.0},
    image_size=(800, 600),
    views=IntrinsicViews(count=14),
    sweep=SweepPlan(placements=2, images=7),
)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rig") / "rig"
    simulate_dataset(folder, OPTIONS)
    return folder


@pytest.fixture(scope="module")
def chain(rig: Path, tmp_path_factory: pytest.TempPathFactory) -> Chain:
    return run_chain(rig, tmp_path_factory.mktemp("out"))


def test_all_gates_pass(chain: Chain) -> None:
    assert [gate for gate in chain.calibration.gates if not gate.passed] == []


def test_run_tells_the_version_of_mrcal(chain: Chain) -> None:
    """It belongs to no package of this environment."""
    software = tomllib.loads((chain.out / "run.toml").read_text())["software"]
    told = {found.mrcal_version for found in chain.calibration.images.intrinsics.values()}
    assert told == {software["packages"]["mrcal"]}


def test_parameters_within_their_uncertainty(chain: Chain) -> None:
    """Simulated truth: each of five parameters within 3.5 of its own standard deviations."""
    assert chain.document["selected"] == "axis-offset"
    pulls = chain.pulls("axis-offset/posterior")
    assert len(pulls) == 5
    assert np.abs(list(pulls.values())).max() < 3.5, pulls


def test_sweep_tells_eccentricity_from_baseline(chain: Chain) -> None:
    """Simulated truth: without the sweep both stay uncertain by their priors' 10 mm."""
    fit = chain.document["fits"]["axis-offset/posterior"]["parameters"]
    assert fit["eccentricity_mm"]["std"] < 1.0
    assert fit["baseline_mm"]["std"] < 1.0
    assert fit["eccentricity_mm"]["identified_by"] == "data"
    told = chain.document["identifiability"]["axis-offset"]
    assert told["parameters"]["eccentricity_mm"]["decided_by"] == "sweep"
    assert told["parameters"]["baseline_mm"]["decided_by"] == "rows and sweep"
    # Pictures of C2 give the gaze residual; how far its centre stands ahead, the sweep says.
    assert fit["standoff_mm"]["std"] < 5.0
    assert told["parameters"]["standoff_mm"]["decided_by"] == "sweep"
    assert not any("words" in combination for combination in told["combinations"])
    sweep = chain.document["sweep"]["eccentricity_mm"]
    assert abs(sweep["value"] - 6.0) < 3.5 * sweep["std"]


def test_intrinsics_and_stereo_against_truth(chain: Chain) -> None:
    """Simulated truth: focal length to 0.5 %, pose of C2 within 3.5 standard deviations."""
    for name in ("c1", "c2"):
        found = np.array(chain.document["intrinsics"][name]["matrix"])
        true = np.array(chain.truth["cameras"][name]["matrix"])
        assert found[0, 0] == pytest.approx(true[0, 0], rel=5e-3)
        pull = (found[0, 0] - true[0, 0]) / chain.document["intrinsics"][name]["std"][0]
        assert abs(pull) < 4
    stereo = chain.document["stereo"]
    error = np.array(stereo["transform_12"])[:3, 3]
    error = error - np.array(chain.truth["stereo"]["transform_12"])[:3, 3]
    assert np.all(np.abs(error) < 4 * np.sqrt(np.diag(stereo["covariance"]))[3:])


def test_validation_depths_inside_their_intervals(chain: Chain) -> None:
    """Simulated truth: of 8 intervals of 95 %, 6 or more hold it with probability 0.994."""
    truth = chain.truth["rows"]["validation"]
    inside = [
        row["low95_mm"] <= truth[row["id"]]["point_mm"][2] <= row["high95_mm"]
        for row in chain.document["validation"]
    ]
    assert sum(inside) >= 6


def test_shared_errors_reach_the_parameters(chain: Chain) -> None:
    """Property: intrinsics and extrinsics load the rows and the instrument."""
    gaze = chain.calibration.gaze
    assert gaze is not None
    assert gaze.calibrated is not None
    assert gaze.rows.shared.shape[2] > 15
    assert gaze.calibrated.instrument.shared is not None
    own = gaze.robust["axis-offset"].by_shared
    assert np.linalg.norm(own[0]) > 0.05 * np.sqrt(gaze.robust["axis-offset"].covariance[0, 0])


SOURCES = {"intrinsics of C1", "intrinsics of C2"}
BY_ROWS = SOURCES | {"pose of C2 (stereo reference)"}


def test_cameras_are_named_where_their_errors_are_counted(chain: Chain) -> None:
    """Property: certificate, budgets and calibration.json know the sources, and no number.

    By the adjustment the pose of C2 is one of the parameters.
    """
    root = checked((chain.out / "certificate.xml").read_bytes())
    named = sources(root)
    assert len(named) >= 3
    assert all(names >= SOURCES for names in named)
    table = shares(root)
    assert len(table) == len(named)
    assert all(0 <= share <= 100 for column in table for share in column)
    measurement = chain.document["measurement"]
    assert set(measurement["shared"]["sources"]) == BY_ROWS
    assert set(measurement["adjustment"]["shared"]["sources"]) == SOURCES
    for row in chain.document["depth_uncertainty"]:
        parts = row["gum_sources_mm"]
        assert set(parts) >= SOURCES
        assert np.linalg.norm(list(parts.values())) == pytest.approx(row["gum_u_mm"], rel=1e-9)
    for name in ("certificate.html", "report.html"):
        text = (chain.out / name).read_text()
        assert all(source in text for source in SOURCES)
        assert not re.search(r"\bshared \d", text)


def test_adjustment_is_the_instrument_and_within_its_covariance(chain: Chain) -> None:
    """Simulated truth: all parameters together, by the true model and by the complete one."""
    document = chain.document
    assert document["method"] == "adjustment"
    assert set(document["fits"]) >= {"axis-offset/adjustment", "complete/adjustment"}
    assert "base/adjustment" in document["not_fitted"]  # e is 6 mm: the pictures show it
    for name in ("axis-offset/adjustment", "complete/adjustment"):
        fit = document["fits"][name]
        error = [fit["parameters"][p]["value"] - chain.truth["parameters"][p] for p in fit["names"]]
        std = np.sqrt(np.diag(fit["covariance"]))
        correlation = np.array(fit["covariance"]) / np.outer(std, std)
        distance = np.array(error) / std @ np.linalg.solve(correlation, np.array(error) / std)
        assert distance < chi2.isf(1e-4, len(std)), name
        assert len(fit["residual_mrad"]) == 8
        assert fit["outliers"] == []
    section = document["adjustment"]
    assert section["pictures"] == {
        "c1 lens": 14, "c1 pair": 8, "c1 row": 8, "c2 lens": 14, "c2 pair": 8, "c2 row": 8,
        "c2 sweep": 14,
    }  # fmt: skip


def test_the_headline_is_of_the_instrument_of_record_everywhere(chain: Chain) -> None:
    """Tile, drawing, terminal and certificate state L_b + e by the adjustment, not by the rows."""
    stated = chain.document["fits"]["complete/adjustment"]["derived"]["effective_baseline_mm"]
    by_rows = chain.document["fits"]["axis-offset/posterior"]["derived"]["effective_baseline_mm"]
    text, other = (plus_minus(one["value"], one["std"]) for one in (stated, by_rows))
    assert text != other
    half = 1.959964 * stated["std"]
    assert stated["q2.5"] == pytest.approx(stated["value"] - half)
    assert stated["q97.5"] == pytest.approx(stated["value"] + half)
    report = (chain.out / "report.html").read_text()
    tiles = report.partition('class="tiles"')[2].partition("</dl>")[0]
    assert text in tiles
    assert other not in tiles
    assert f"= {text} mm" in html.unescape(report.partition('id="data"')[2])
    value, u = text.split(" ± ")
    told, _ = summary(chain.out)
    of_record = told.partition("selected model")[0]
    assert re.search(rf"effective_baseline_mm +{re.escape(value)} \+- {re.escape(u)}", of_record)
    assert summary_json(chain.out)[0]["parameters"]["effective_baseline_mm"] == stated
    certificate = (chain.out / "certificate.html").read_text()
    line = certificate.partition("baseline seen at 90")[2].partition("</tr>")[0]
    assert value in line
    assert "1.96" in line
    # Every parameter has U, k and an interval.
    lines = certificate.partition("Calibrated parameters")[2].partition("</table>")[0]
    assert "–" not in lines


def test_the_archive_has_the_adjustment(chain: Chain) -> None:
    with h5py.File(chain.out / "results.h5") as file:
        group, stated = (
            file["fits/complete/adjustment"], chain.document["fits"]["complete/adjustment"]
        )  # fmt: skip
        assert [name.decode() for name in group["names"]] == stated["names"]
        np.testing.assert_allclose(group["covariance"], stated["covariance"], rtol=1e-11)
        residuals, names = file["adjustment/residuals"], file["adjustment/images"]
        assert len(residuals) == len(names)
        rms = np.sqrt(np.nanmean(np.square(residuals[:])))
        assert rms == pytest.approx(chain.document["adjustment"]["rms_px"], rel=1e-11)
        assert residuals.attrs["units"] == "px"
        for lens, unit in zip(
            file["adjustment/lens_names"], file["adjustment/lens_covariance"].attrs["units"],
            strict=True,
        ):  # fmt: skip
            assert (unit == "px") == (lens.decode()[3:4] in "fc")


def test_the_python_door_measures_by_either(chain: Chain) -> None:
    rig = calib.load(chain.out)
    assert {"rows", "adjustment"} <= set(rig.models)
    asked = {"u1_px": [380.0], "v1_px": [310.0], "alpha2_deg": [84.0]}
    by = {name: rig.measure(**asked, model=name).xyz_mm[0, 2] for name in ("rows", "adjustment")}
    assert rig.measure(**asked).xyz_mm[0, 2] == by["adjustment"] != by["rows"]


def test_one_file_measures_by_rows_and_by_adjustment(chain: Chain) -> None:
    """Property: the same reading by either agrees within their uncertainties; the default is that
    of record, with the adjusted cameras."""
    found = read_calibration(chain.out / "calibration.json")
    table = read_measurements("id,u1_px,v1_px,alpha2_deg\na,380,310,84\n", name="t")
    by = {m: measure_by(found, table, model=m) for m in ("selected", "rows", "adjustment")}
    assert by["selected"].position_mm == pytest.approx(by["adjustment"].position_mm, rel=1e-12)
    apart = np.abs(by["rows"].position_mm - by["adjustment"].position_mm)
    assert np.all(apart > 0)
    assert np.all(apart < 3 * by["rows"].std_mm)
    c1 = found.setup.cameras.c1
    assert c1 is not None
    adjusted = chain.document["adjustment"]["intrinsics"]["c1"]["matrix"]
    assert c1.matrix == pytest.approx(np.array(adjusted), rel=1e-11)


@pytest.fixture(scope="module")
def bare(rig: Path, tmp_path_factory: pytest.TempPathFactory) -> Chain:
    """The rig's lens pictures and gaze rows with both pictures: no pairs, sweep, depths."""
    folder = edited(rig, tmp_path_factory.mktemp("bare") / "rig")
    manifest = tomllib.loads((folder / "dataset.toml").read_text())
    for section in ("stereo", "sweep", "lengths"):
        del manifest[section]
    manifest["gaze"]["reference"] = "squares of the board"
    (folder / "dataset.toml").write_text(tomli_w.dumps(manifest))
    rows = [line.split(",")[:4] for line in (folder / "gaze.csv").read_text().splitlines()]
    (folder / "gaze.csv").write_text("\n".join(map(",".join, rows)) + "\n")
    return run_chain(folder, tmp_path_factory.mktemp("out"))


@pytest.mark.slow
def test_rows_with_both_pictures_calibrate_alone(bare: Chain, chain: Chain) -> None:
    """Simulated truth: the squares give the scale; depths hold their intervals."""
    assert bare.calibration.passed
    assert bare.document["method"] == "adjustment"
    assert "stereo" not in bare.document
    pulls = bare.pulls("complete/adjustment")
    assert np.abs(list(pulls.values())).max() < 4, pulls
    truth = bare.truth["rows"]["validation"]
    inside = [
        row["low95_mm"] <= truth[row["id"]]["point_mm"][2] <= row["high95_mm"]
        for row in bare.document["validation"]
    ]
    assert sum(inside) >= 6
    u, whole = (
        np.array([row["u_mm"] for row in run.document["depth_uncertainty"]])
        for run in (bare, chain)
    )
    assert np.median(u / whole) < 1.5


def edited(rig: Path, out: Path) -> Path:
    """Return a copy of the rig's folder (images linked) that a test may spoil."""
    shutil.copytree(rig, out, copy_function=lambda a, b: Path(b).hardlink_to(a))
    for name in ("dataset.toml", "gaze.csv", "validation.csv", "sweep.csv"):
        text = (rig / name).read_text()
        (out / name).unlink()
        (out / name).write_text(text)
    return out


def failed(chain: Chain) -> str:
    return "; ".join(f"{g.name}: {g.detail}" for g in chain.calibration.gates if not g.passed)


@pytest.mark.slow
def test_reversed_encoder_is_named(rig: Path, tmp_path: Path) -> None:
    """Negative control: 180 deg less every reading."""
    folder = edited(rig, tmp_path / "reversed")
    for name in ("gaze.csv", "validation.csv", "sweep.csv"):
        lines = (folder / name).read_text().splitlines()
        column = lines[0].split(",").index("alpha2_deg")
        rows = [line.split(",") for line in lines[1:]]
        for row in rows:
            row[column] = repr(180 - float(row[column]))
        text = "\n".join([lines[0], *(",".join(row) for row in rows)]) + "\n"
        (folder / name).write_text(text)
    chain = run_chain(folder, tmp_path / "out")
    assert not chain.calibration.passed
    assert "encoder" in failed(chain)
    assert "counts the" in failed(chain)


def test_swapped_cameras_are_named(
    rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Negative control: C1's pictures given as C2's and the other way round, in all tables."""
    folder = edited(rig, tmp_path / "swapped")
    for name in ("dataset.toml", "gaze.csv", "validation.csv"):
        path = folder / name
        text = path.read_text()
        text = text.replace("stereo/c1/", "stereo/@/").replace("stereo/c2/", "stereo/c1/")
        path.write_text(text.replace("stereo/@/", "stereo/c2/"))
    text = (folder / "dataset.toml").read_text()
    text = text.replace("intrinsics/c1/", "intrinsics/@/").replace(
        "intrinsics/c2/", "intrinsics/c1/"
    )
    (folder / "dataset.toml").write_text(text.replace("intrinsics/@/", "intrinsics/c2/"))
    leave_out_pages(monkeypatch.setattr)
    chain = run_chain(folder, tmp_path / "out")
    assert not chain.calibration.passed
    assert "swapped" in failed(chain)
    assert chain.calibration.gaze is None, "no number from swapped cameras"


@pytest.mark.slow
@pytest.mark.parametrize("columns", [8, 10])
def test_board_count_off_by_one_is_named(rig: Path, tmp_path: Path, columns: int) -> None:
    """Negative control: the manifest states a column less or more than the board has."""
    folder = edited(rig, tmp_path / "miscounted")
    text = (folder / "dataset.toml").read_text()
    assert text.count("columns = 9") == 1
    (folder / "dataset.toml").write_text(text.replace("columns = 9", f"columns = {columns}"))
    with pytest.raises(InputError, match=r"correct columns and rows in \[board\]"):
        run_chain(folder, tmp_path / "out")


@pytest.mark.slow
def test_twenty_rendered_rigs(tmp_path: Path) -> None:
    """Simulated truth, twenty seeds: pulls, coverage, focal lengths.

    The four pulls of a rig hang together: of honest ones the rms over ten rigs was seen between 0.7
    and 1.1, over twenty its standard deviation is some 0.1.
    """
    pulls, inside, eccentricity, focal = [], [], [], []
    for seed in range(20):
        folder = tmp_path / f"rig{seed}"
        options = SimulationOptions(seed=100 + seed, images=True, rows=14, validation_rows=10)
        simulate_dataset(folder, options)
        chain = run_chain(folder, tmp_path / f"out{seed}")
        pulls.append(list(chain.pulls("axis-offset/posterior").values()))
        truth = chain.truth["rows"]["validation"]
        inside += [
            row["low95_mm"] <= truth[row["id"]]["point_mm"][2] <= row["high95_mm"]
            for row in chain.document["validation"]
        ]
        fit = chain.document["fits"]["axis-offset/posterior"]["parameters"]
        eccentricity.append(fit["eccentricity_mm"]["std"])
        for name in ("c1", "c2"):
            found = chain.document["intrinsics"][name]["matrix"][0][0]
            focal.append(found / chain.truth["cameras"][name]["matrix"][0][0] - 1)
        shutil.rmtree(folder)
    values = np.array(pulls)
    assert np.abs(values).max() < 3.5
    assert 0.7 < np.sqrt(np.mean(values**2)) < 1.4
    assert 0.90 <= np.mean(inside) <= 0.99
    assert max(eccentricity) < 1.0
    assert np.abs(focal).max() < 5e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"views": IntrinsicViews(count=16, tilt_deg=(0, 0))}, "focal"),
        ({"views": IntrinsicViews(count=16, one_place=True)}, "coverage"),
        ({"sweep": SweepPlan(placements=1, images=9, half_range_deg=1.0)}, "sweep-span"),
    ],
)
def test_poor_scenes_are_recognised(change: dict[str, object], word: str, tmp_path: Path) -> None:
    """Negative controls: boards parallel to the imager, at one place; a sweep of two degrees."""
    options = replace(OPTIONS, image_size=(640, 480), rows=6, validation_rows=0, **change)
    simulate_dataset(tmp_path / "rig", options)
    chain = run_chain(tmp_path / "rig", tmp_path / "out")
    assert not chain.calibration.passed
    assert word in failed(chain)
