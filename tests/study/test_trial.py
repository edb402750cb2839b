"""One rig, many rigs, who works on them. Evidence: simulated truth and properties."""

from __future__ import annotations

import argparse
import csv
import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import distributed
import numpy as np
import pytest

from calib.cli.study import add_arguments, run
from calib.core.errors import UsageError
from calib.study.advice import run_advice
from calib.study.conditions import CONDITIONS
from calib.study.depths import ModelDepths, depth_record
from calib.study.rigs import BEYOND, INSIDE, set_up
from calib.study.run import run_study
from calib.study.tasks import StudyTask, key_of, perform
from calib.study.trial import cramer_rao, run_trial

RIGS = 3
FAST = ("base-14",)


def test_a_rig_depends_on_seed_and_number_alone() -> None:
    condition = CONDITIONS["axis-offset-14"]
    first = run_trial(condition, seed=5, number=1)
    run_trial(condition, seed=5, number=0)
    assert run_trial(condition, seed=5, number=1) == first
    assert json.loads(json.dumps(first, allow_nan=False)) == first
    assert run_trial(condition, seed=6, number=1)["parameters"] != first["parameters"]


def test_conditions_differ_in_nothing_but_what_they_say() -> None:
    """Property: the same rig, the same targets; outliers change some rows and no other."""
    clean = set_up(CONDITIONS["axis-offset-60"], seed=1, number=0)
    spoilt = set_up(CONDITIONS["axis-offset-60-outliers"], seed=1, number=0)
    np.testing.assert_array_equal(clean.rig.theta, spoilt.rig.theta)
    same = (
        (clean.rows.z_mm == spoilt.rows.z_mm)
        & (clean.rows.x1c == spoilt.rows.x1c)
        & (clean.rows.alpha2_rad == spoilt.rows.alpha2_rad)
    )
    assert 40 <= same.sum() < 60
    half = set_up(CONDITIONS["stated-half"], seed=1, number=0)
    np.testing.assert_allclose(half.rows.std, half.true_std / 2)
    assert half.noise_scale == 2
    far = clean.rows.z_mm.max()
    assert clean.true_depths_mm[INSIDE].max() <= clean.true_rows.z_mm.max()
    assert clean.true_depths_mm[BEYOND].min() >= clean.true_rows.z_mm.max()
    assert clean.true_depths_mm[BEYOND].max() <= 1.51 * far
    hidden = set_up(CONDITIONS["reference-hidden"], seed=1, number=0)
    stated = set_up(CONDITIONS["reference-shared"], seed=1, number=0)
    assert not hidden.rows.shared_names
    assert stated.rows.shared_names
    np.testing.assert_array_equal(hidden.rows.z_mm, stated.rows.z_mm)


def test_bound_is_that_of_the_paper_s_two_unknowns() -> None:
    """Property: against the bound from a numerical derivative of the residual by parameters."""
    from calib.fit.noise import row_noise
    from calib.geometry.misclosure import misclosure
    from calib.geometry.parameters import MODELS

    bench = set_up(CONDITIONS["base-14"], seed=1, number=0)
    theta, rows = bench.rig.theta, bench.true_rows
    sigma = row_noise(theta, rows).sigma
    columns = []
    for i, step in ((0, 1e-3), (1, 1e-7)):
        ahead, behind = theta.copy(), theta.copy()
        ahead[i] += step
        behind[i] -= step
        up, down = (misclosure(t, rows.gaze, rows.z_mm).value for t in (ahead, behind))
        columns.append((up - down) / (2 * step) / sigma)
    slope = np.stack(columns, axis=1)
    np.testing.assert_allclose(
        cramer_rao(MODELS["base"], bench), np.linalg.inv(slope.T @ slope), rtol=1e-5
    )


def test_average_lies_between_the_models_and_holds_their_doubt() -> None:
    """Property: of two equal models the mixture is either; of two that differ it is wider."""
    bench = set_up(CONDITIONS["axis-offset-6"], seed=1, number=0)
    truth = bench.true_depths_mm
    one = ModelDepths(
        factor95=2.1,
        noise_factor=1.0,
        z_mm={part: 1.01 * z for part, z in truth.items()},
        u_mm={part: 0.01 * z for part, z in truth.items()},
        below={part: np.full(len(z), 0.2) for part, z in truth.items()},
    )
    other = replace(
        one,
        z_mm={part: 0.97 * z for part, z in truth.items()},
        below={part: np.full(len(z), 0.99) for part, z in truth.items()},
    )
    alone = depth_record([1.0], [one], bench)[INSIDE]
    twice = depth_record([0.3, 0.7], [one, one], bench)[INSIDE]
    mixed = depth_record([0.5, 0.5], [one, other], bench)[INSIDE]
    for key, value in alone.items():
        np.testing.assert_allclose(twice[key], value, rtol=1e-9)
    np.testing.assert_allclose(alone["error_rel"], 0.01, rtol=1e-9)
    np.testing.assert_allclose(mixed["error_rel"], -0.01, rtol=1e-9)
    np.testing.assert_allclose(mixed["rank"], (0.2 + 0.99) / 2)
    assert np.all(mixed["u_rel"] > 2 * alone["u_rel"])
    assert np.all(mixed["measure95"] == 1)


def test_models_are_averaged_where_there_are_several() -> None:
    several = run_trial(CONDITIONS["base-6"], seed=5, number=0)
    assert sum(several["weights"].values()) == pytest.approx(1.0, abs=1e-5)
    assert len(several["averaged"][INSIDE]["rank"]) == len(several["depths"][INSIDE]["rank"])
    assert "averaged" not in run_trial(CONDITIONS["ranks-base"], seed=5, number=0)


def test_advice_is_recorded() -> None:
    record = run_advice(seed=2, number=0)
    assert set(record["u_rel"]) == {"random", "G", "D"}
    assert 0 < record["u_rel"]["G"] < record["before_rel"]


def test_a_study_goes_on_where_it_stopped(tmp_path: Path) -> None:
    """Property: no finished rig is computed again, and the outcome is that of one go."""
    path = tmp_path / "rigs.jsonl"
    part = run_study(path, FAST, rigs=1, seed=3)
    seen: list[int] = []
    whole = run_study(path, FAST, rigs=RIGS, seed=3, progress=lambda done, _: seen.append(done))
    assert seen == [2, 3]
    assert whole[0] == part[0]
    assert len(path.read_text().splitlines()) == RIGS
    assert whole == run_study(tmp_path / "again.jsonl", FAST, rigs=RIGS, seed=3)


def test_processes_give_what_one_process_gives(tmp_path: Path) -> None:
    alone = [perform(StudyTask("base-14", 3, i, key_of("base-14", 3))) for i in range(RIGS)]
    shared = run_study(tmp_path / "rigs.jsonl", FAST, rigs=RIGS, seed=3, jobs=2)
    assert list(shared) == alone


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_cluster_survives_the_death_of_a_worker(tmp_path: Path) -> None:
    """Property: two workers over TCP, one killed on the way; the records are the serial ones.

    The package's own warnings at shutdown are not ours to judge.
    """
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        protocol="tcp://",
        dashboard_address="127.0.0.1:0",
    ) as cluster:
        assert cluster.scheduler_address.startswith("tcp://")
        with distributed.Client(cluster) as client:
            workers = list(client.run(os.getpid).values())
        killed: list[int] = []

        def kill_one(_done: int, _of: int) -> None:
            if not killed:
                killed.append(workers[0])
                os.kill(workers[0], signal.SIGKILL)

        records = run_study(
            tmp_path / "rigs.jsonl", FAST, rigs=8, seed=3,
            scheduler=cluster.scheduler_address, progress=kill_one,
        )  # fmt: skip
    assert killed
    assert [r["number"] for r in records] == list(range(8))
    assert records[0] == perform(StudyTask("base-14", 3, 0, key_of("base-14", 3)))


def study(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return run(parser.parse_args(arguments))


def test_command_writes_table_and_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status = study(
        "--out", str(tmp_path), "--rigs", "4", "--seed", "3",
        "--condition", "base-14", "--condition", "ranks-base",
    )  # fmt: skip
    assert status in (0, 3)
    with (tmp_path / "scores.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["condition"] for row in rows} == {"base-14", "ranks-base"}
    coverage = [r for r in rows if r["subject"] == "depth inside" and r["estimator"] == "selected"]
    assert all(0 <= float(r["value"]) <= 1 for r in coverage if "coverage" in r["statistic"])
    document = json.loads((tmp_path / "scores.json").read_text())
    assert document["settings"]["seed"] == 3
    assert (status == 3) == any(claim["broken"] for claim in document["claims"])
    for name in ("coverage", "coverage-averaged", "pulls", "efficiency", "ranks"):
        assert (tmp_path / f"{name}.svg").read_text().startswith("<?xml")
    assert "depth intervals" in capsys.readouterr().out


def test_wrong_use_is_explained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calib.stages.cluster.CONNECT_SECONDS", 1)
    with pytest.raises(UsageError, match="unknown; choose from"):
        study("--out", str(tmp_path), "--condition", "sunshine")
    with pytest.raises(UsageError, match="no Dask scheduler answers"):
        study("--out", str(tmp_path), "--rigs", "1", "--scheduler", "tcp://127.0.0.1:9")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--rigs", "0"], "'0': give a whole number from 1"),
        (["--jobs", "many"], "'many': give a whole number from 1"),
        (["--seed", "-1"], "'-1': give a whole number from 0"),
    ],
)
def test_wrong_numbers_are_explained(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        study(*arguments)
    assert ended.value.code == 2
    assert message in capsys.readouterr().err
