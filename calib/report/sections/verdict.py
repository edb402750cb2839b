"""The verdict: whether the result may be used, for what, and what its user must know."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from calib.core.gate import Gate
from calib.images.result import ImageResult
from calib.instrument.adjusted import ADJUSTMENT, ROWS
from calib.instrument.calibrated import CalibratedInstrument
from calib.report.blocks import (
    Block,
    Chapter,
    CommandLine,
    Fold,
    Items,
    KeyFigures,
    Notice,
    Paragraph,
    Text,
    table,
    words,
)
from calib.report.context import ReportContext
from calib.report.numbers import (
    EFFECTIVE,
    bounds,
    factor,
    plus_minus,
    signed,
    symbol,
    unit,
    with_sign,
)
from calib.report.prose import capital, sentence, typeset
from calib.report.sections.contradiction import what_the_errors_do
from calib.results.calibration import Calibration, GazeResult
from calib.results.headline import headline
from calib.uncertainty.format import significant

_BACKENDS = {"joint": "the joint solve of lenses and pairs"}


def verdict(c: Calibration, context: ReportContext) -> Chapter:
    """Write the verdict."""
    blocks: list[Block] = [_banner(c, context), *_failures(c)]
    if c.gaze is not None:
        blocks += _gaze(c.gaze, context, passed=c.passed)
    else:
        blocks += _rig(c.images, passed=c.passed)
    if c.disagreements or c.warnings:
        blocks += [
            Paragraph(Markup("<strong>To bear in mind</strong>")),
            Items(tuple(sentence(text) for text in (*c.disagreements, *c.warnings))),
        ]
    if c.gaze is not None and c.gaze.calibrated is not None:
        blocks += _use(c.gaze.calibrated, failed=sum(not gate.passed for gate in c.gates))
    blocks += _gates(c)
    return Chapter("verdict", "Verdict", tuple(blocks))


def _banner(c: Calibration, context: ReportContext) -> Notice:
    failed = sum(not gate.passed for gate in c.gates)
    if not c.gates:
        return Notice("note", "Nothing was checked", "The dataset holds nothing to calibrate.")
    if failed:
        return Notice(
            "bad",
            f"{failed} of {len(c.gates)} checks failed",
            "Do not use this calibration before what they name is mended. What follows is there to "
            "help with that, not to be used.",
        )
    if c.disagreements:
        told = "" if c.gaze is None else what_the_errors_do(c.gaze, context.validation_reference)
        return Notice(
            "caution",
            "Contradicted by the independent reference",
            f"Do not rely on absolute depths before that is cleared up. {told}"
            f"All {len(c.gates)} checks passed, and the uncertainties stated hold against the "
            "reference that was used to calibrate.",
        )
    if c.gaze is None:
        scope = "The dataset has no gaze rows: cameras and rig are calibrated as far as it goes."
    else:
        scope = "The calibration may be used within the depths and the uncertainties stated here."
    return Notice("good", f"All {len(c.gates)} checks passed", scope)


def _failures(c: Calibration) -> list[Block]:
    """Return the checks that failed, the one that names a cause first."""
    failed = [gate for gate in c.gates if not gate.passed]
    failed.sort(key=lambda gate: gate.name != "diagnosis")
    return [Notice("bad", f"Failed: {gate.name}", sentence(gate.detail)) for gate in failed]


def _rig(images: ImageResult, *, passed: bool) -> list[Block]:
    """Return the first figures of a dataset without gaze rows."""
    tiles: list[tuple[Text, Text, Text]] = []
    for name, found in sorted(images.intrinsics.items()):
        f, u = float(found.camera.matrix[0, 0]), float(np.sqrt(found.covariance[0, 0]))
        by = _BACKENDS.get(found.selected.backend, found.selected.backend)
        told = (
            f"fx of {name.upper()}",
            f"{plus_minus(f, u)} px",
            f"by {by}",
        )
        tiles.append(told)
    if images.stereo is not None:
        distance = plus_minus(images.stereo.baseline_mm, images.stereo.baseline_std_mm)
        tiles.append(("C1 to C2", f"{distance} mm", "distance of the optical centres"))
    return [KeyFigures(tuple(tiles), void=not passed)] if tiles else []


def _gaze(gaze: GazeResult, context: ReportContext, *, passed: bool) -> list[Block]:
    if gaze.comparison is None:
        reasons = tuple(f"{name}: {reason}" for name, reason in gaze.refused.items())
        return [Notice("bad", "No model could be fitted"), Items(reasons)]
    tiles = [*_parameter_tiles(gaze), *_depth_tiles(gaze), *_validation_tiles(gaze, context)]
    return [
        KeyFigures(tuple(tiles), void=not passed),
        *_instrument(gaze),
        Paragraph(
            Markup("Selected model{}: <strong>{}</strong>. {}.").format(
                "" if gaze.choice is None or gaze.choice.method == ROWS else " of the gaze rows",
                gaze.comparison.selected,
                capital(gaze.comparison.reason),
            )
        ),
    ]


def _instrument(gaze: GazeResult) -> list[Block]:
    """Say from what the instrument is taken, where there is a choice."""
    if gaze.choice is None:
        return []
    by = {ROWS: "the gaze rows", ADJUSTMENT: "the adjustment of all pictures"}[gaze.choice.method]
    words = Markup("Depths and the figures above are by <strong>{}</strong>: {}.")
    return [Paragraph(words.format(by, gaze.choice.reason))]


def _parameter_tiles(gaze: GazeResult) -> list[tuple[Text, Text, Text]]:
    of_record = headline(gaze)
    if of_record is None:
        return []
    std = np.sqrt(np.diag(of_record.covariance))
    found, ends = of_record.effective, of_record.effective95
    tiles: list[tuple[Text, Text, Text]] = []
    if found is not None:
        between = "" if ends is None else f"; 95 %: {bounds(*ends, found[1]).text} mm"
        tiles.append(_tile(EFFECTIVE, *found, f"baseline seen at 90°{between}"))
    for name, value, u in zip(of_record.names, of_record.values, std, strict=True):
        if name in ("baseline_mm", "delta2_rad", "axis_z_mm") and not (
            name == "baseline_mm" and found is not None
        ):
            tiles.append(_tile(name, float(value), float(u), _MEANINGS[name]))
    return tiles


_MEANINGS = {
    "baseline_mm": "baseline",
    "delta2_rad": "zero error of the encoder",
    "axis_z_mm": "yaw axis in front of C1 (behind, if negative)",
}


def _tile(name: str, value: float, u: float, meaning: str) -> tuple[Text, Text, Text]:
    text = f"{plus_minus(value, u, factor=factor(name))} {unit(name)}"
    return symbol(name), text, meaning


def _depth_tiles(gaze: GazeResult) -> list[tuple[Text, Text, Text]]:
    """Return the depth uncertainty at both ends of the calibrated depths, as certified.

    Where nothing is certified, that on C1's axis.
    """
    certified = () if gaze.evidence is None else gaze.evidence.depths
    inside = [one.result for one in certified if not one.extrapolated]
    told = [
        (r.z_mm, r.standard_uncertainty_mm, f"where it is largest, x1c = {signed(f'{r.x1c:.2f}')}")
        for r in inside
    ]
    if not told and gaze.depths is not None:
        table = gaze.depths
        told = [
            (float(table.depth_mm[i]), float(table.prediction.u_mm[i]), "on C1's optical axis")
            for i in np.flatnonzero(np.asarray(table.extrapolated) == 0)
        ]
    tiles: list[tuple[Text, Text, Text]] = []
    for z, u, where in dict.fromkeys((told[0], told[-1])) if told else ():
        title = Markup("<i>u</i>(<i>z</i>) at {} mm").format(f"{z:.0f}")
        if u is None or not np.isfinite(u):
            tiles.append((title, "none", f"the distribution has no variance ({where})"))
        else:
            share = f"{significant(100 * u / z, digits=2)} % of depth, {where}"
            tiles.append((title, f"{significant(u, digits=2)} mm", share))
    return tiles


def _validation_tiles(gaze: GazeResult, context: ReportContext) -> list[tuple[Text, Text, Text]]:
    if gaze.validation is None:
        return []
    first = gaze.validation.errors[0]
    return [
        (
            f"validation against {context.validation_reference or 'reference'}",
            f"{significant(100 * first.rms_rel, digits=2)} %",
            f"error of depth, root mean square; mean {with_sign(100 * first.mean_rel)} %",
        )
    ]


def _use(calibrated: CalibratedInstrument, *, failed: int) -> list[Block]:
    if failed:
        what = "A check" if failed == 1 else f"{failed} checks"
        return [
            Paragraph(
                Markup(
                    "<strong>Do not use this result.</strong> {} failed; mend what {} and "
                    "calibrate again. Until then, whatever uses this calibration says so."
                ).format(what, "it names" if failed == 1 else "they name")
            )
        ]
    low, high = calibrated.calibrated_mm
    return [
        Paragraph(
            Markup(
                "<strong>What to do with it.</strong> The command below turns new readings of the "
                "same rig into positions with uncertainties. A depth outside {} to {} mm is "
                "extrapolated."
            ).format(f"{low:.0f}", f"{high:.0f}")
        ),
        CommandLine("calib measure calibration.json readings.csv"),
    ]


def _gates(c: Calibration) -> list[Block]:
    """Return the checks by stage: those that passed behind one line, stages with a failure open."""
    stages: dict[str, list[Gate]] = {}
    for gate in c.gates:
        stages.setdefault(_stage(gate.name), []).append(gate)
    return [
        Fold(
            summary=_outcome(stage, gates),
            blocks=(_checks(stage, gates),),
            is_open=not all(gate.passed for gate in gates),
        )
        for stage, gates in stages.items()
    ]


_STAGES = {
    "c1": "Intrinsics of C1",
    "c2": "Intrinsics of C2",
    "stereo": "Stereo reference",
    "sweep": "Yaw sweep",
}


def _stage(gate: str) -> str:
    """Return the stage that a gate belongs to, by the first part of its name."""
    return _STAGES.get(gate.partition("-")[0], "Gaze calibration")


def _outcome(stage: str, gates: Sequence[Gate]) -> Text:
    failed = [gate.name for gate in gates if not gate.passed]
    if not failed:
        count = "1 check" if len(gates) == 1 else f"all {len(gates)} checks"
        return Markup('<span class="good">✓</span> {}: {} passed').format(stage, count)
    how_many = "its check" if len(gates) == 1 else f"{len(failed)} of {len(gates)} checks"
    return Markup('<span class="caution">▲</span> {}: {} failed ({})').format(
        stage, how_many, ", ".join(failed)
    )


def _checks(stage: str, gates: Sequence[Gate]) -> Block:
    rows = [
        (
            words("passed" if gate.passed else "failed", mark="good" if gate.passed else "bad"),
            words(gate.name),
            words(typeset(gate.detail)),
        )
        for gate in gates
    ]
    heads = ("Outcome", "Check", "Figures that decided it")
    return table(f"Checks: {stage}", heads, rows, sortable=True)
