"""Pictures of a wide lens. Evidence: closed forms; corners detected in rendered pictures lie where
the lens model puts them; what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.core.errors import UsageError
from calib.geometry.board import Board
from calib.geometry.camera import normalise, project
from calib.images.detection.board import find_chessboard
from calib.simulate.contents import SimulationOptions
from calib.simulate.pattern import board_pattern
from calib.simulate.plan import plan_dataset
from calib.simulate.render import Optics, prepare, render
from calib.simulate.rig import draw_wide_camera
from calib.simulate.scene import IntrinsicViews, SweepPlan, rotation

SIZE = (640, 480)


@pytest.mark.parametrize("field", [90.0, 150.0, 165.0])
def test_drawn_lens_has_the_field_asked_for(field: float) -> None:
    for seed in range(5):
        lens = draw_wide_camera(np.random.default_rng(seed), field_deg=field, image_size=SIZE)
        rim = np.array([[0.0, 0], [639, 0], [0, 479], [639, 479]])
        angle = np.degrees(np.arctan(np.hypot(*normalise(lens, rim).T)))
        # The principal point is a few pixels off the middle, a pixel some 0.2 deg.
        assert angle.mean() == pytest.approx(field / 2, abs=1.5)


def test_corners_of_a_rendered_board_lie_where_the_lens_puts_them() -> None:
    rng = np.random.default_rng(1)
    lens = draw_wide_camera(rng, field_deg=150.0, image_size=SIZE)
    board = Board("chessboard", 9, 6, 25.0, (4, 3))
    away = np.deg2rad(35.0)
    turn = rotation(np.array([0.0, away, 0.0])) @ rotation(np.array([0.3, 0.0, 0.2]))
    pose = np.eye(4)
    pose[:3, :3] = turn
    middle = board.object_points().mean(axis=0)
    pose[:3, 3] = 260 * np.array([np.sin(away), 0.0, np.cos(away)]) - turn @ middle
    picture = render(prepare(lens, Optics(noise=0.5)), board_pattern(board), pose, rng)
    true = project(lens, board.object_points() @ turn.T + pose[:3, 3])
    found = find_chessboard(picture, board).pixels
    assert np.isfinite(found).all()
    error = np.linalg.norm(found - true, axis=-1)
    error = min(error, np.linalg.norm(found[::-1] - true, axis=-1), key=np.median)
    assert np.sqrt(np.mean(error**2)) < 0.1


def test_what_cannot_be_drawn_is_refused() -> None:
    with pytest.raises(UsageError, match="add --images"):
        plan_dataset(SimulationOptions(seed=1, c1_field_deg=150.0))
    for field in (30.0, 200.0):
        with pytest.raises(UsageError, match="60 to 165 degrees"):
            plan_dataset(SimulationOptions(seed=1, images=True, c1_field_deg=field))


def test_manifest_is_free_of_the_truth_and_all_else_stays() -> None:
    few = SimulationOptions(
        seed=2,
        images=True,
        rows=2,
        validation_rows=1,
        views=IntrinsicViews(count=2),
        sweep=SweepPlan(placements=1, images=2),
    )
    wide = plan_dataset(replace(few, c1_field_deg=150.0))
    assert wide.truth["cameras"]["c1"]["projection"] == "equidistant"
    assert "projection" not in wide.truth["cameras"]["c2"]
    usual = plan_dataset(few)
    assert wide.truth["parameters"] == usual.truth["parameters"]
    assert wide.truth["cameras"]["c2"] == usual.truth["cameras"]["c2"]
