"""Whether the lens is known where rows look. Evidence: simulated scenes, negative controls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import lens_scenes as scenes
import numpy as np
import pytest

from calib.checks.field import field_gate
from calib.core.arrays import FloatArray
from calib.geometry.camera import normalise
from calib.images.intrinsics.calibrate import Intrinsics, calibrate_intrinsics


@dataclass(frozen=True)
class Rows:
    ids: tuple[str, ...]
    x1c: FloatArray
    y1c: FloatArray


@dataclass(frozen=True)
class Gazes:
    rows: Rows


def looking_at(lens: Intrinsics, pixels: list[tuple[float, float]]) -> Any:
    xy = normalise(lens.camera, np.array(pixels))
    return cast(Any, Gazes(Rows(tuple(f"g{i}" for i in range(len(xy))), xy[:, 0], xy[:, 1])))


@pytest.fixture(scope="module")
def middle() -> Intrinsics:
    """Boards in the middle of the picture alone, at many tilts, and no mrcal."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CALIB_MRCAL_PYTHON", "/nonexistent/python")
        rng = np.random.default_rng(0)
        views = scenes.views(12, rng, place=lambda g: g.uniform([-40, -30, 500], [40, 30, 750]))
        return calibrate_intrinsics(views, scenes.BOARD, camera="c1", seed=1)


def test_rows_in_the_middle_pass_with_a_lens_known_there(middle: Intrinsics) -> None:
    assert field_gate(middle, looking_at(middle, [(320, 240), (280, 200), (360, 260)])).passed


def test_rows_where_no_board_was_fail_by_name(middle: Intrinsics) -> None:
    gate = field_gate(middle, looking_at(middle, [(320, 240), (590, 260)]))
    assert not gate.passed
    assert "1 rows look where the lens of C1 is not known" in gate.detail
    assert "(g1)" in gate.detail


def test_a_coverage_of_a_fifth_is_not_made_good_by_certainty(middle: Intrinsics) -> None:
    assert middle.coverage.share < 0.3
    assert "c1-coverage" in {g.name for g in middle.gates if not g.passed}
