"""Evidence: property, and numpy's Cholesky factor as an independent tool."""

from __future__ import annotations

import numpy as np
import pytest

from calib.rows.common_errors import CommonErrors

NAMES = ("c1.fx", "c1.cx", "c2.fx", "c2.cx", "r12.x", "t12.x", "t12.z")
SOURCES = {
    "c1": "intrinsics of C1",
    "c2": "intrinsics of C2",
    "r12": "pose of C2 (stereo reference)",
    "t12": "pose of C2 (stereo reference)",
}
UNIT = np.array([2.0, 0.3, 2.5, 0.4, 1e-5, 0.02, 0.3])


def covariance(rank: int, seed: int = 1) -> np.ndarray:
    """Return a covariance of NAMES, its quantities of very different size."""
    root = UNIT[:, None] * np.random.default_rng(seed).normal(size=(len(NAMES), rank))
    return root @ root.T


def in_units(matrix: np.ndarray) -> np.ndarray:
    return matrix / np.outer(UNIT, UNIT)


def test_of_full_rank_it_is_the_cholesky_factor() -> None:
    known = covariance(20)
    shared = CommonErrors.of(NAMES, known)
    assert shared.names == NAMES
    assert shared.error_names == tuple(SOURCES[n.split(".")[0]] for n in NAMES)
    np.testing.assert_allclose(
        shared.factor / UNIT[:, None], np.linalg.cholesky(in_units(known)), atol=1e-12
    )


@pytest.mark.parametrize("rank", [1, 2, 3, 5, 7])
def test_of_any_rank_it_gives_the_covariance_back(rank: int) -> None:
    known = covariance(rank)
    shared = CommonErrors.of(NAMES, known)
    assert shared.factor.shape == (7, rank)
    np.testing.assert_allclose(
        in_units(shared.factor @ shared.factor.T), in_units(known), atol=1e-12
    )
    # Two or three directions that C1's intrinsics and C2's explain leave the pose none of its own.
    counts = [shared.error_names.count(name) for name in dict.fromkeys(SOURCES.values())]
    assert counts == [min(rank, 2), min(max(rank - 2, 0), 2), max(rank - 4, 0)]


def test_an_error_moves_its_own_quantity_and_those_after_it() -> None:
    shared = CommonErrors.of(NAMES, covariance(20))
    assert np.all(np.triu(shared.factor, 1) < 1e-12 * UNIT[:, None])
    # Of C2's intrinsics given C1's: the Schur complement.
    known = covariance(20)
    of_c2 = np.array([name == "intrinsics of C2" for name in shared.error_names])
    own = shared.factor[2:4, of_c2]
    given = known[2:4, 2:4] - known[2:4, :2] @ np.linalg.inv(known[:2, :2]) @ known[:2, 2:4]
    np.testing.assert_allclose(own @ own.T, given, rtol=1e-9)


def test_a_singular_part_begins_no_error_and_loses_nothing() -> None:
    """Two intrinsics of C1 that move together: one error, and all of the others' errors."""
    known = covariance(20)
    turn = np.eye(7)
    turn[1] = [0.15, 0, 0, 0, 0, 0, 0]
    known = turn @ known @ turn.T
    shared = CommonErrors.of(NAMES, known)
    assert [shared.error_names.count(n) for n in dict.fromkeys(SOURCES.values())] == [1, 2, 3]
    np.testing.assert_allclose(
        in_units(shared.factor @ shared.factor.T), in_units(known), atol=1e-12
    )


def test_a_nearly_singular_covariance_keeps_its_small_directions() -> None:
    """Lens coefficients correlate to 1 - 1e-8: what cancels in a measurement must still do so."""
    rng = np.random.default_rng(4)
    turn = np.linalg.qr(rng.normal(size=(7, 7)))[0]
    known = turn @ np.diag([1, 1e-2, 1e-4, 1e-6, 1e-8, 1e-9, 1e-10]) @ turn.T
    shared = CommonErrors.of(NAMES, known)
    for size, direction in zip([1e-4, 1e-6, 1e-8], turn.T[2:5], strict=True):
        found = float(np.sum((direction @ shared.factor) ** 2))
        assert found == pytest.approx(size, rel=1e-4)


def test_known_quantities_and_empty_covariances_have_no_errors() -> None:
    known = covariance(20)
    known[:, 4:], known[4:] = 0.0, 0.0
    shared = CommonErrors.of(NAMES, known)
    assert shared.names == NAMES[:4]
    assert "pose of C2 (stereo reference)" not in shared.error_names
    assert CommonErrors.of(NAMES, np.zeros((7, 7))).names == ()


def test_rounding_of_the_covariance_does_not_turn_the_factor() -> None:
    """Property: equal inputs but for their last bits give equal factors but for theirs."""
    known = covariance(20)
    noise = np.random.default_rng(5).normal(0, 1e-15, (7, 7))
    other = known * (1 + noise + noise.T)
    one, two = (CommonErrors.of(NAMES, c).factor / UNIT[:, None] for c in (known, other))
    np.testing.assert_allclose(one, two, atol=1e-11)


def test_a_quantity_of_no_source_stands_for_itself() -> None:
    assert CommonErrors.of(("scale",), np.eye(1)).error_names == ("scale",)
