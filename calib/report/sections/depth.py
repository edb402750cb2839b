"""Depth uncertainty over the range."""

from __future__ import annotations

from markupsafe import Markup

from calib.instrument import CalibratedInstrument, DepthTable
from calib.report.blocks import Block, Cell, Paragraph, Section, Table, table, words
from calib.report.context import ReportContext
from calib.report.figures.depth import draw_depth_uncertainty
from calib.report.numbers import bounds, decimals, digits, percent
from calib.report.plotting import picture
from calib.results import Calibration


def depth(c: Calibration, _: ReportContext) -> Section | None:
    """Write the depth uncertainty."""
    if c.gaze is None or c.gaze.depths is None or c.gaze.calibrated is None:
        return None
    calibrated, depths = c.gaze.calibrated, c.gaze.depths
    blocks: list[Block] = [
        Paragraph(_method(calibrated)),
        picture(
            "depth-uncertainty",
            draw_depth_uncertainty(depths, calibrated.calibrated_mm),
            "95 % interval of one measured depth of a target on C1's optical axis, in per cent of "
            "the depth. Where the dashed lines of the linear law leave the band, only the band may "
            "be used. A band that opens quickly beyond the calibrated depths (hatched: outside "
            "them) asks for targets farther away.",
        ),
        _table(depths),
    ]
    return Section("depth", "Depth uncertainty", tuple(blocks))


def _method(calibrated: CalibratedInstrument) -> Markup:
    widened = ""
    if calibrated.noise_factor > 1.005:
        widened = (
            " As the rows do not exclude that the stated uncertainties of a reading are too small, "
            f"these were widened by the factor {calibrated.noise_factor:.2f}, the root mean square "
            "of the noise scale where it is above 1."
        )
    return Markup(
        "The interval comes from draws of the posterior of <em>{}</em>, each with an error of the "
        "reading: what is uncertain of the calibration and of one new reading together. The linear "
        "law of propagation (JCGM 100) stands beside it; whether its interval may be used was "
        "decided by clause 8 of JCGM 101.{}"
    ).format(calibrated.model, widened)


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
