"""Published values of the same cameras, where the dataset states some."""

from __future__ import annotations

import numpy as np

from calib.geometry.camera import intrinsic_names, intrinsic_vector
from calib.geometry.poses import invert_pose
from calib.images.result import ImageResult
from calib.report.blocks import EMPTY, Cell, Paragraph, Section, number, table, words
from calib.report.context import ReportContext
from calib.report.numbers import estimate
from calib.results.calibration import Calibration


def published(c: Calibration, context: ReportContext) -> Section | None:
    """Write the comparison with published values."""
    if not context.published:
        return None
    found = _estimates(c.images)
    rows = [_row(name, known, found.get(name)) for name, known in context.published.items()]
    return Section(
        "published",
        "Against published values",
        (
            Paragraph(
                "Values that others have published for these cameras, with their standard "
                "uncertainties, beside those found here. The last column is the difference over "
                "the uncertainty of the difference: beyond 2 the two contradict each other, or one "
                "uncertainty is too small. Both come from the same pictures where the source says "
                "so; the difference should then be well below 1."
            ),
            table(
                "Published and found; C1 in C2 is P2 = R P1 + t",
                ("Quantity", "Published ± u", "Found ± u", "Difference / u"),
                rows,
            ),
        ),
    )


def _estimates(images: ImageResult) -> dict[str, tuple[float, float]]:
    """Return value and standard uncertainty by quantity."""
    found: dict[str, tuple[float, float]] = {}
    for camera, result in images.intrinsics.items():
        names = intrinsic_names(result.camera)
        values, std = intrinsic_vector(result.camera), np.sqrt(np.diag(result.covariance))
        for name, value, u in zip(names, values, std, strict=True):
            found[f"{camera}.{name}"] = float(value), float(u)
    if images.stereo is not None:
        pose, covariance = invert_pose(images.stereo.pose_12, images.stereo.covariance)
        kinds = [f"rotation_{axis}_rad" for axis in "xyz"]
        kinds += [f"translation_{axis}_mm" for axis in "xyz"]
        for i, kind in enumerate(kinds):
            found[f"c1_in_c2.{kind}"] = float(pose[i]), float(np.sqrt(covariance[i, i]))
    return found


def _row(
    name: str, known: tuple[float, float], here: tuple[float, float] | None
) -> tuple[Cell, ...]:
    value, u = known
    shown = estimate(value, u)
    if here is None:
        return words(name), shown, EMPTY, EMPTY
    score = (here[0] - value) / float(np.hypot(here[1], u))
    mark = "bad" if abs(score) > 2 else ""
    return (
        words(name),
        shown,
        estimate(*here),
        number(f"{score:+.1f}", score, mark=mark),
    )
