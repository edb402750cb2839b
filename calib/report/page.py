"""The report as one HTML file: self-contained, no network, readable without scripts."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Callable
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from calib.report.blocks import Chapter
from calib.report.context import ReportContext
from calib.report.sections.adjustment import adjustment
from calib.report.sections.comparison import comparison
from calib.report.sections.data import data
from calib.report.sections.depth import depth
from calib.report.sections.detection import detection
from calib.report.sections.diagnosis import diagnosis
from calib.report.sections.identifiability import identifiability
from calib.report.sections.intrinsics import intrinsics
from calib.report.sections.linear import linear
from calib.report.sections.parameters import parameters
from calib.report.sections.posterior import posterior
from calib.report.sections.provenance import provenance
from calib.report.sections.published import published
from calib.report.sections.residuals import residuals
from calib.report.sections.stereo import stereo
from calib.report.sections.sweep import sweep
from calib.report.sections.validation import validation
from calib.report.sections.verdict import verdict
from calib.results.calibration import Calibration
from calib.results.wording import printable

SECTIONS: tuple[Callable[[Calibration, ReportContext], Chapter | None], ...] = (
    verdict,
    data,
    detection,
    intrinsics,
    stereo,
    sweep,
    adjustment,
    published,
    parameters,
    identifiability,
    residuals,
    diagnosis,
    linear,
    comparison,
    validation,
    depth,
    posterior,
    provenance,
)
"""The report in its order; a section without data leaves itself out."""


def render_report(calibration: Calibration, context: ReportContext) -> str:
    """Return report.html."""
    written = (section(calibration, context) for section in SECTIONS)
    script = _own("report.js")
    page = (
        _environment()
        .get_template("report.html.j2")
        .render(
            c=calibration,
            context=context,
            sections=[section for section in written if section is not None],
            style=_own("report.css"),
            script=script,
            script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        )
    )
    return printable(page)


def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("calib.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _own(name: str) -> Markup:
    """Return a file of this package as it is."""
    text = files("calib.report").joinpath("templates", name).read_text("utf-8")
    return Markup(text)  # noqa: S704 - the package's own file, no data in it
