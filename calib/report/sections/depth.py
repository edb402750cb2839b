"""Depth uncertainty over the range."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from calib.instrument.adjusted import ADJUSTMENT
from calib.instrument.calibrated import CalibratedInstrument, DepthTable
from calib.report.blocks import Block, Cell, Chapter, Paragraph, Table, table, words
from calib.report.context import ReportContext
from calib.report.figures.depth import draw_depth_uncertainty
from calib.report.numbers import bounds, decimals, digits, percent, places
from calib.report.plotting import picture
from calib.report.sections.pick import instrument_of_record
from calib.results.calibration import Calibration, GazeResult
from calib.rows.observations import GROUP_SOURCE
from calib.uncertainty.format import widening

SHOWN_DEPTHS = 5
"""Depths of the table of sources."""


def depth(c: Calibration, _: ReportContext) -> Chapter | None:
    """Write the depth uncertainty."""
    if c.gaze is None or c.gaze.depths is None or c.gaze.calibrated is None:
        return None
    calibrated, depths = c.gaze.calibrated, c.gaze.depths
    blocks: list[Block] = [
        Paragraph(_method(calibrated, c.gaze)),
        picture(
            "depth-uncertainty",
            draw_depth_uncertainty(depths, calibrated.calibrated_mm),
            "95 % interval of one measured depth of a target on C1's optical axis, in per cent of "
            "the depth. Where the dashed lines of the linear law leave the band, only the band may "
            "be used. A band that opens quickly beyond the calibrated depths (hatched: outside "
            "them) asks for targets farther away.",
        ),
        _table(depths),
        _sources(depths),
    ]
    return Chapter("depth", "Depth uncertainty", tuple(blocks))


def _method(calibrated: CalibratedInstrument, gaze: GazeResult) -> Markup:
    widened = ""
    if calibrated.noise_factor > 1.005:
        widened = (
            " As the rows scatter more than stated, the stated uncertainties of a reading were "
            f"widened by the factor {widening(calibrated.noise_factor)}, the root mean square of "
            "the noise scale."
        )
    return Markup(
        "The interval comes from draws of the {}, each with an error of the "
        "reading: what is uncertain of the calibration and of one new reading together. The linear "
        "law of propagation (JCGM 100) stands beside it; whether its interval may be used was "
        "decided by clause 8 of JCGM 101.{}"
    ).format(_drawn(gaze), widened)


def _drawn(gaze: GazeResult) -> Markup:
    """Return of what distribution parameters are drawn."""
    by = instrument_of_record(gaze)
    adjusted = gaze.choice is not None and gaze.choice.method == ADJUSTMENT
    return (Markup("parameters by {}") if adjusted else Markup("posterior of {}")).format(by)


def _sources(depths: DepthTable) -> Table:
    """Return what each source contributes to u(z), at a few depths."""
    few = np.unique(np.linspace(0, len(depths.depth_mm) - 1, SHOWN_DEPTHS).round().astype(int))
    u = depths.prediction.gum_u_mm
    rows = [
        [
            words(name.replace("alpha2", "α2")),
            *(decimals(part[i], places(u[[i]] / 10)) for i in few),
        ]
        for name, part in depths.sources_mm.items()
    ]
    together: list[Cell] = [words("together"), *(digits(u[i], 2) for i in few)]
    return table(
        "Where u(z) comes from, mm, by the linear law",
        ["Source", *(f"at {depths.depth_mm[i]:.0f} mm" for i in few)],
        [*rows, together],
        note="The sources are independent and add up in quadrature. Parameters: what rows and "
        "priors leave uncertain of them. Intrinsics and pose of the cameras: what their errors do "
        "to a depth by way of the parameters and of the reading together, the later ones as far "
        f"as the earlier do not explain them. {_groups(depths)}A row with the largest numbers is "
        "what to improve.",
    )


def _groups(depths: DepthTable) -> str:
    """Return what the line of groups of rows means, if there is one."""
    if GROUP_SOURCE not in depths.sources_mm:
        return ""
    what = "what the common error of rows with one reference adds"
    return f"{GROUP_SOURCE.capitalize()}: {what}. "


def _table(depths: DepthTable) -> Table:
    p = depths.prediction
    rows: list[tuple[Cell, ...]] = []
    for i, z in enumerate(depths.depth_mm):
        outside = bool(depths.extrapolated[i])
        valid = bool(p.gum_valid[i])
        rows.append(
            (
                decimals(z, 0),
                digits(p.u_mm[i], 2),
                percent(p.u_mm[i] / z),
                bounds(p.low95_mm[i], p.high95_mm[i], p.u_mm[i]),
                digits(p.gum_u_mm[i], 2),
                words("yes" if valid else "no", mark="" if valid else "bad"),
                words("extrapolated", mark="caution") if outside else words(""),
            )
        )
    heads = (
        "z / mm",
        "u(z) / mm",
        "u(z) / % of z",
        "95 % interval / mm",
        "u(z) by the linear law / mm",
        "linear law valid",
        "",
    )
    return table("Depth uncertainty on C1's optical axis", heads, rows, sortable=True)
