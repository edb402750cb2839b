"""A rig with C2 on the left is the mirror image of one with C2 on the right; so is its result.

Evidence: the same rig written twice, decimal for decimal, once as a mirror shows it. Tables give
the mirror image in every figure, those of random draws included. So do pictures up to the rows;
what follows rows is the same for either. A walk of many random steps tells even the last bit of a
row, which a solver on mirrored corners does not hit.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from chain_runs import run_chain
from left_rigs import ODD, mirror_dataset

from calib.chain.images import ImageStages, image_stages
from calib.chain.rows import gaze_rows
from calib.core.arrays import FloatArray
from calib.dataset.corner_cache import write_cache
from calib.dataset.load import load_dataset
from calib.geometry.board import Corners
from calib.geometry.camera import project
from calib.geometry.mirror import mirror_camera
from calib.mirror.problem import Mirror
from calib.rows.observations import Observations
from calib.simulate.contents import Contents, SimulationOptions
from calib.simulate.dataset import simulate_dataset
from calib.simulate.plan import plan_dataset
from calib.simulate.scene import IntrinsicViews, SweepPlan
from calib.stages.store import Store
from tests.reliability.short_chain import leave_out_pages, shorten

CLOSE = 1e-9
SIDES = ("right", "left")
TABLES = SimulationOptions(seed=7, model="axis-tilt", rows=16, validation_rows=6)
PICTURES = SimulationOptions(
    seed=11,
    images=True,
    rows=6,
    validation_rows=0,
    image_size=(800, 600),
    views=IntrinsicViews(count=8),
    sweep=SweepPlan(placements=2, images=6),
)
CORNER_STD_PX = 0.05


def _sign(name: str) -> float:
    return -1.0 if name in ODD else 1.0


def _signs(names: list[str]) -> FloatArray:
    return np.array([_sign(name) for name in names])


def _estimate(name: str, stated: dict[str, Any]) -> dict[str, Any]:
    """Return a parameter's entry in the mirror: quantiles change places."""
    found = dict(stated)
    if name in ODD:
        if "q2.5" in found:
            found["q2.5"], found["q97.5"] = found["q97.5"], found["q2.5"]
        for key in found.keys() & {"value", "q2.5", "q50", "q97.5"}:
            found[key] = -found[key]
    return found


def _direction(stated: dict[str, float]) -> dict[str, float]:
    largest = max(stated, key=lambda name: abs(stated[name]))
    return {name: _sign(name) * _sign(largest) * part for name, part in stated.items()}


def _mirrored(value: Any, key: str = "") -> Any:
    """Return what calibration.json of the mirror image must say where the rig's says `value`."""
    if isinstance(value, list):
        return [_mirrored(item, key) for item in value]
    if not isinstance(value, dict):
        return -value if key in ("residual_mrad", "standardised_residual", "x_mm") else value
    found = {k: _mirrored(v, k) for k, v in value.items()}
    if key in ("parameters", "derived"):
        found = {name: _estimate(name, stated) for name, stated in value.items()}
    if "direction" in value:
        found["direction"] = _direction(value["direction"])
    if "names" in value:
        sign = _signs(value["names"])
        for array, factor in (
            ("values", sign),
            ("covariance", np.outer(sign, sign)),
            ("correlation", np.outer(sign, sign)),
        ):
            if array in value:
                found[array] = (np.array(value[array]) * factor).tolist()
        if "importance" in value:
            found["importance"]["mean"] = (np.array(value["importance"]["mean"]) * sign).tolist()
    return found


def _assert_close(found: Any, wanted: Any, where: str = "") -> None:
    if isinstance(wanted, Mapping):
        assert found.keys() == wanted.keys(), where
        for key, item in wanted.items():
            _assert_close(found[key], item, f"{where}/{key}")
    elif isinstance(wanted, list):
        assert len(found) == len(wanted), where
        for i, item in enumerate(wanted):
            _assert_close(found[i], item, f"{where}/{i}")
    elif isinstance(wanted, float):
        assert found == pytest.approx(wanted, rel=CLOSE, abs=1e-15), where
    else:
        assert found == wanted, where


def test_tables_of_a_left_rig_give_the_mirror_image(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shorten(monkeypatch.setattr)
    leave_out_pages(monkeypatch.setattr)
    simulate_dataset(tmp_path / "right", TABLES)
    manifest = tomllib.loads((tmp_path / "right" / "dataset.toml").read_text())
    manifest["priors"] = {"delta2_rad": [0.004, 0.01], "eccentricity_mm": [-3.0, 5.0]}
    (tmp_path / "right" / "dataset.toml").write_text(tomli_w.dumps(manifest))
    mirror_dataset(tmp_path / "right", tmp_path / "left")

    right, left = (
        run_chain(tmp_path / side, tmp_path / f"{side}-out") for side in ("right", "left")
    )
    wanted, found = _mirrored(right.document), left.document
    for document in (wanted, found):
        direction = document["gates"][0]
        assert direction.pop("name") == "encoder-direction"
        del document["integrity"], document["dataset"], direction["detail"]
    assert (wanted.pop("rig"), found.pop("rig")) == ({"c2": "right"}, {"c2": "left"})
    _assert_close(found, wanted)
    assert found["fits"]["base/posterior"]["parameters"]["baseline_mm"]["value"] < -60

    results = [run.calibration.gaze for run in (right, left)]
    evidence = [gaze.evidence for gaze in results if gaze is not None and gaze.evidence is not None]
    assert len(evidence) == 2
    for here, there in zip(*(e.depths for e in evidence), strict=True):
        assert there.result.interval == here.result.interval
        flip = np.array([-1.0, 1, 1])
        np.testing.assert_allclose(there.position.position_mm, here.position.position_mm * flip)
        np.testing.assert_allclose(
            there.position.covariance_mm2, here.position.covariance_mm2 * np.outer(flip, flip)
        )


def _pictures(folder: Path) -> Path:
    """Write a dataset whose pictures are given by their corners, to 1e-4 px."""
    contents = plan_dataset(PICTURES)
    simulate_dataset(folder, SimulationOptions(seed=0, rows=6, validation_rows=0))
    manifest = dict(contents.manifest) | {
        "board": dict(contents.manifest["board"]) | {"corners": "corners.vnl"}
    }
    (folder / "dataset.toml").write_text(tomli_w.dumps(manifest))
    for name, table in contents.tables.items():
        lines = [",".join(table.columns), *(",".join(map(str, row)) for row in table.rows)]
        (folder / name).write_text("\n".join(lines) + "\n")
    (folder / "corners.vnl").write_text(write_cache(_corners(contents)))
    return folder


def _corners(contents: Contents) -> list[Corners]:
    rng, points = np.random.default_rng(2), contents.board.object_points()
    found = []
    for name, camera in (("c1", contents.rig.c1), ("c2", contents.rig.c2)):
        shots = [shot for shot in contents.shots if shot.camera == name]
        pixels = np.stack(
            [project(camera, points @ s.pose[:3, :3].T + s.pose[:3, 3]) for s in shots]
        )
        pixels += CORNER_STD_PX * rng.standard_normal(pixels.shape)
        paths = tuple(shot.path for shot in shots)
        found.append(Corners(paths, pixels, ("cache",) * len(paths), camera.image_size))
    return found


def _seen(folder: Path, out: Path) -> tuple[ImageStages, Observations]:
    dataset = load_dataset(folder)
    store = Store(out, lambda _: None, lambda *_: None)
    with store.locked():
        images = image_stages(dataset, store, 0)
        assert images.failures() == {}
        assert dataset.gaze is not None
        return images, gaze_rows(dataset, dataset.gaze, store, images).value


@pytest.mark.slow
def test_pictures_of_a_left_rig_give_the_mirror_image_up_to_the_rows(tmp_path: Path) -> None:
    right = _pictures(tmp_path / "right")
    left = mirror_dataset(right, tmp_path / "left")
    here, rows = _seen(right, tmp_path / "a")
    there, own = _seen(left, tmp_path / "b")
    for name in ("c1", "c2"):
        lens = here.intrinsics[name].value.camera, there.intrinsics[name].value.camera
        wanted = mirror_camera(lens[0])
        np.testing.assert_allclose(lens[1].matrix, wanted.matrix, rtol=CLOSE)
        np.testing.assert_allclose(lens[1].distortion, wanted.distortion, atol=CLOSE)
    poses = [images.stereo.value for images in (here, there) if images.stereo is not None]
    flip = np.diag([-1.0, 1, 1, 1])
    difference = poses[1].transform_12 - flip @ poses[0].transform_12 @ flip
    assert np.abs(difference[:3, :3]).max() < CLOSE
    assert np.abs(difference[:3, 3]).max() < CLOSE * poses[0].baseline_mm
    sweeps = [images.sweep.value for images in (here, there) if images.sweep is not None]
    sign, std = _signs(list(sweeps[0].names)), np.sqrt(np.diag(sweeps[0].covariance))
    np.testing.assert_allclose(sweeps[1].mean / std, sign * sweeps[0].mean / std, atol=1e-8)

    mirrored = Mirror.of(there.shared.value).rows(own)
    for name in ("x1c", "y1c", "alpha2_rad", "gaze_residual_rad", "z_mm"):
        np.testing.assert_allclose(
            getattr(mirrored, name), getattr(rows, name), rtol=CLOSE, atol=CLOSE, err_msg=name
        )
    # Noise of single pictures is told to the tolerance of a pose from one view.
    np.testing.assert_allclose(mirrored.std, rows.std, rtol=1e-6, atol=1e-15)
    size = np.maximum(np.abs(rows.shared).max(axis=(0, 2)), 1e-9)[None, :, None]
    np.testing.assert_allclose(mirrored.shared / size, rows.shared / size, atol=1e-6)
