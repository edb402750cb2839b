"""What was calibrated, and with what data."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from markupsafe import Markup

from calib.geometry.lens import PROJECTIONS
from calib.geometry.parameters import embed
from calib.geometry.plane import OBSERVABLE
from calib.report.blocks import (
    EMPTY,
    Block,
    Cell,
    Chapter,
    DefinitionList,
    Paragraph,
    Scene,
    Table,
    Text,
    table,
    words,
)
from calib.report.context import ReportContext
from calib.report.figures.setup import draw_setup
from calib.report.numbers import (
    EFFECTIVE,
    bounds,
    decimals,
    digits,
    estimate,
    places,
    plain_symbol,
    plus_minus,
)
from calib.report.plotting import picture
from calib.report.scene import scene_data
from calib.report.sections.pick import contrasted, shown_rows
from calib.results.calibration import Calibration, GazeResult
from calib.results.headline import Headline, headline
from calib.rows.observations import Observations


def data(c: Calibration, context: ReportContext) -> Chapter:
    """Write what was calibrated and with what data."""
    facts: list[tuple[Text, Text]] = [("Dataset", c.title or c.name), ("Name", c.name)]
    facts += context.source
    blocks: list[Block] = [
        Paragraph(
            "Active gazing: the monitor camera C1 stands still, the gazing camera C2 turns about a "
            "yaw axis until a target lies on the centre column of its image, and an encoder reads "
            "the angle α2. Depth is where C1's ray to the target meets C2's gaze plane. The "
            "calibration finds where that plane is for a given reading."
        )
    ]
    if c.gaze is not None:
        facts += _gaze_facts(c.gaze, context)
    blocks.append(DefinitionList(tuple(facts)))
    if c.gaze is not None:
        blocks += _sketch(c.gaze)
    if context.statements:
        blocks.append(_statements(context))
    if c.gaze is not None:
        blocks.append(_rows(c.gaze))
    if c.cameras:
        blocks.append(_cameras(c))
    return Chapter("data", "What was calibrated, and with what", tuple(blocks))


def _gaze_facts(gaze: GazeResult, context: ReportContext) -> list[tuple[Text, Text]]:
    rows = gaze.rows
    facts: list[tuple[Text, Text]] = [
        ("Calibration rows", f"{len(rows)}, at depths {_range(rows.z_mm)} mm"),
        ("Calibration reference", context.reference or "not stated"),
    ]
    if gaze.validation is not None:
        v = gaze.validation
        groups = len(set(v.groups))
        placed = f" in {groups} groups" if 1 < groups < len(v.ids) else ""
        further = [e.name for e in v.errors[1:]]
        facts += [
            ("Validation rows", f"{len(v.ids)}{placed}, at depths {_range(v.reference_mm)} mm"),
            ("Validation reference", context.validation_reference or "not stated"),
        ]
        if further:
            facts.append(("Further references", ", ".join(further)))
    return facts


def _range(z_mm: np.ndarray) -> str:
    return f"{np.nanmin(z_mm):.0f} to {np.nanmax(z_mm):.0f}"


def _sketch(gaze: GazeResult) -> list[Block]:
    found = headline(gaze)
    if found is None:
        return []
    theta = embed(found.values, found.names)
    return [
        picture(
            "setup",
            draw_setup(gaze.rows, theta, found.names, effective=_effective(found)),
            Markup(
                "The rig from above. Left: the symbols, with the values of <em>{}</em>. The yaw "
                "axis stands at X = <i>L</i><sub>b</sub>, Z = <i>Z</i><sub>a</sub>, and the gaze "
                "plane passes it at the distance <i>e</i>. Right: where the targets stood. Targets "
                "in one line with C1, or all at one depth, would not determine the calibration; a "
                "target on the wrong side betrays a wrong sign of x1c."
            ).format("the adjustment of all pictures" if found.by_adjustment else found.model),
        ),
        *_scene(gaze, theta),
    ]


def _effective(found: Headline) -> str:
    """Return L_b + e with its 95 % interval for the drawing; empty without an eccentricity."""
    if found.effective is None or found.effective95 is None:
        return ""
    between = bounds(*found.effective95, found.effective[1]).text
    return f"{plain_symbol(EFFECTIVE)} = {plus_minus(*found.effective)} mm\n95 %: {between} mm"


def _scene(gaze: GazeResult, theta: np.ndarray) -> list[Block]:
    """Return the rig in three dimensions."""
    depths = () if gaze.evidence is None else gaze.evidence.depths
    return [
        Scene(
            "rig",
            scene_data(gaze.rows, theta, depths),
            "The rig and its targets, to scale: drag or use the arrow keys to turn it, wheel or + "
            "and − to zoom (the wheel after a click); point at a target for its place, or go from "
            "one to the next with keys N and P. Orange: rays of C1; blue: the yaw axis, and lines "
            "from it to the targets; green: 95 % ellipsoids of position at the certified depths, "
            "enlarged as written in the corner (key M: true size).",
        )
    ]


def _statements(context: ReportContext) -> Table:
    return table(
        "Taken as given",
        ("Quantity", "Value", "Source"),
        [(words(s.what), words(s.value), words(s.source)) for s in context.statements],
        note="u is a standard uncertainty. The noise scale of each model, further down, says how "
        "well these statements agree with the residuals: 1 is perfect agreement.",
    )


def _rows(gaze: GazeResult) -> Table:
    rows, fits = gaze.rows, contrasted(gaze)
    picked, note = shown_rows(len(rows))
    columns = _columns(rows)
    heads = [*columns, *(f"residual of {fit.model} / mrad" for fit in fits)]
    outliers = {name for fit in fits[-1:] for name in fit.outliers}
    body = [
        (
            *(column(i) for column in columns.values()),
            *(decimals(fit.residual_mrad[i], places(fit.residual_mrad)) for fit in fits),
        )
        for i in picked
    ]
    if outliers:
        note = (
            f"{note} Outliers under {fits[-1].model}: {', '.join(sorted(outliers)[:20])}.".strip()
        )
    return table("Calibration rows", heads, body, note=note, sortable=True)


def _columns(rows: Observations) -> dict[str, Callable[[int], Cell]]:
    """Return head and cells of the columns that these rows fill."""
    grouped, seen = rows.groups != rows.ids, rows.std[:, OBSERVABLE.residual] > 0
    columns: dict[str, Callable[[int], Cell]] = {"Row": lambda i: words(rows.ids[i])}
    if grouped:
        columns["Group"] = lambda i: words(rows.groups[i])
    columns["x1c"] = lambda i: decimals(rows.x1c[i], 4)
    if rows.has_height:
        columns["y1c"] = lambda i: decimals(rows.y1c[i], 4)
    columns["α2 / °"] = lambda i: decimals(np.rad2deg(rows.alpha2_rad[i]), 3)
    if seen.any():
        columns["gaze residual / mrad"] = lambda i: (
            decimals(1e3 * rows.gaze_residual_rad[i], 2) if seen[i] else EMPTY
        )
    columns["z reference ± u / mm"] = lambda i: estimate(rows.z_mm[i], _u_depth(rows, i))
    return columns


def _u_depth(rows: Observations, i: int) -> float:
    """Return the standard uncertainty of a reference depth, shared errors included, mm."""
    shared = rows.shared[i, OBSERVABLE.z] if rows.shared_names else np.zeros(0)
    return float(np.hypot(rows.std[i, OBSERVABLE.z], np.linalg.norm(shared)))


def _cameras(c: Calibration) -> Table:
    rows = []
    for name, camera in sorted(c.cameras.items()):
        (fx, _, cx), (_, fy, cy), _ = camera.matrix
        width, height = camera.image_size
        lens = ", ".join(digits(float(k), 4).text for k in camera.distortion)
        rows.append(
            (
                words(name.upper()),
                words(f"{width} × {height}"),
                *(decimals(float(value), 2) for value in (fx, fy, cx, cy)),
                words(lens or "none"),
                words(PROJECTIONS[camera.projection].words),
            )
        )
    px = ("Image / px", "fx / px", "fy / px", "cx / px", "cy / px")
    heads = ("Camera", *px, "Lens distortion", "Lens model")
    return table("Intrinsics", heads, rows, note="Lens distortion in the order of OpenCV.")
