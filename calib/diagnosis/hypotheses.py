"""The table of hypotheses: what labs do wrong, one entry each.

Adding one is one entry of `HYPOTHESES`, with a function of `calib.diagnosis.trials` that says what
it does to the rows. Names are a contract: `calibration.json` and `[corrections]` use them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from calib.diagnosis import trials
from calib.diagnosis.trials import DEG, Trials


@dataclass(frozen=True)
class Hypothesis:
    """A mistake that labs make.

    Parameters
    ----------
    name
        Key in files.
    trials
        What it does to rows, and where it may have struck.
    unit, per_unit
        Of its parameter in files, and its size in mm, rad or 1.
    typical
        Standard deviation of the parameter's prior about 0, in `unit`.
    text
        What it says; may hold `{value}`, the estimate with its uncertainty and unit, and `{at}`.
    remedy
        What to do about it.
    tells
        What measurement distinguishes it from what looks like it.
    of_readings
        Whether later readings have the error as well, until it is mended.
    is_odd
        Whether the parameter changes its sign in a mirror.
    by_references
        What it says where independent references show it; "" where they do not.
    is_size
        Whether it has several parameters, whose root sum of squares is stated.
    """

    name: str
    trials: Trials
    unit: str
    per_unit: float
    typical: float
    text: str
    remedy: str
    tells: str
    of_readings: bool = False
    is_odd: bool = False
    is_size: bool = False
    by_references: str = ""


_RETURN = "return to the first target every ten rows and compare the readings"
_TWO_SIDES = "gaze at one target from both sides of approach"
_SWEEP = "a yaw sweep before a board at rest ([sweep])"
_TAPE = "measure one target's depth by another method, once near and once far"
_BOARD = "calibrate C1 with images of a board"

_ENTRIES = (
    Hypothesis(
        "range-not-depth", trials.range_not_depth, "1", 1.0, 1.0,
        "z_mm is the distance along the ray from C1, not the depth along its optical axis (share "
        "found: {value})",
        "divide each z_mm by sqrt(1 + x1c^2 + y1c^2)", _TAPE,
    ),
    Hypothesis(
        "reference-offset", trials.reference_offset, "mm", 1.0, 50.0,
        "z_mm counts from {value} in front of C1's optical centre",
        "state z_from in [gaze], or measure from C1's optical centre", _TAPE,
        by_references="validation depths count from {value} in front of where the calibration "
        "rows' do",
    ),
    Hypothesis(
        "reference-scale", trials.by_references_alone, "%", 0.01, 3.0,
        "all reference depths of the calibration rows are {value} too large",
        "check the scale of the reference (tape, squares of the board, baseline of the pairs) "
        "against a known length, and calibrate again",
        "measure known lengths across and known depths, near and far",
        by_references="against independent references all of the calibration rows' depths are "
        "{value} too large",
    ),
    Hypothesis(
        "reference-bias-near", trials.bias_near, "mm", 1.0, 30.0,
        "reference depths {at} are {value} off", "measure the near references again", _TAPE,
    ),
    Hypothesis(
        "reference-bias-far", trials.bias_far, "%", 0.01, 3.0,
        "reference depths {at} are {value} off", "measure the far references again", _TAPE,
    ),
    Hypothesis(
        "reading-step", trials.reading_step, "deg", DEG, 0.3,
        "from row {at} on alpha2 reads {value} more than before",
        "look for a slip, a lost step or a new homing there; calibrate with the rows of one "
        "side of it", _RETURN, is_odd=True,
        by_references="alpha2 reads {value} more in the validation rows than in the calibration "
        "rows",
    ),
    Hypothesis(
        "reading-drift", trials.reading_drift, "deg", DEG, 0.3,
        "alpha2 drifts by {value} from the first row to the last",
        "let the rig warm up, fix cables and couplings, take the rows again", _RETURN,
        is_odd=True,
    ),
    Hypothesis(
        "backlash", trials.backlash, "deg", DEG, 0.3,
        "alpha2 differs by {value} between the two sides of approach",
        "end each move from the same side, by more than the backlash", _TWO_SIDES,
    ),
    Hypothesis(
        "microstep", trials.microstep, "deg", DEG, 0.05,
        "alpha2 errs by up to {value}, with the period of a full step of the motor",
        "stop C2 at full steps, or read an encoder on the load", _SWEEP,
        of_readings=True, is_size=True,
    ),
    Hypothesis(
        "encoder-twice-per-turn", trials.twice_per_turn, "deg", DEG, 0.3,
        "alpha2 errs by up to {value}, twice per turn",
        "centre the encoder's disc, or calibrate it by a yaw sweep", _SWEEP,
        of_readings=True, is_size=True,
    ),
    Hypothesis(
        "c1-distortion-left-in", trials.distortion, "1", 1.0, 0.3,
        "C1's coordinates carry a cubic distortion of k1 = {value}",
        "undistort them, once: give u1_px and v1_px with the lens in [cameras.c1]", _BOARD,
        of_readings=True,
    ),
    Hypothesis(
        "c1-principal-point", trials.principal_point, "1", 1.0, 0.03,
        "x1c is {value} too large throughout, as with a wrong principal point (times the focal "
        "length: pixels)",
        "check cx, cropping and binning of C1's pictures", _BOARD,
        of_readings=True, is_odd=True,
    ),
    Hypothesis(
        "c1-focal-length", trials.focal_length, "%", 0.01, 3.0,
        "the focal length behind C1's coordinates is {value} too small (or the pictures were "
        "resized)",
        "check fx, fy and image_size of C1 against the pictures that were used",
        f"{_BOARD}, or {_SWEEP}", of_readings=True,
    ),
    Hypothesis(
        "x-mirrored", trials.x_mirrored, "1", 1.0, 1.0,
        "x1c has the opposite sign", "x1c is positive to the right; look for a mirrored picture",
        "look at a picture of C1: a target to the right has positive x1c", of_readings=True,
    ),
    Hypothesis(
        "y-mirrored", trials.y_mirrored, "1", 1.0, 1.0,
        "y1c has the opposite sign", "y1c is positive downwards; look for a flipped picture",
        "look at a picture of C1: a target below the middle has positive y1c", of_readings=True,
    ),
    Hypothesis(
        "rows-exchanged", trials.exchanged, "1", 1.0, 1.0,
        "rows are exchanged: {at}", "exchange them back, after a look at the notes",
        "measure these two targets again",
    ),
    Hypothesis(
        "group-reference", trials.group_reference, "mm", 1.0, 30.0,
        "the reference depth of group {at} is {value} too large",
        "measure that depth again, or leave the group out", "measure that depth again",
    ),
    Hypothesis(
        "unit", trials.in_unit, "1", 1.0, 1.0,
        "a unit is wrong: {at}", "convert the column to mm or degrees",
        "measure one row again, with the unit in mind",
    ),
    Hypothesis(
        "rehomed", trials.rehomed, "deg", DEG, 0.3,
        "in rows {at} alpha2 reads {value} more than before and after",
        "home the rig once; calibrate without these rows", _RETURN, is_odd=True,
    ),
)  # fmt: skip

HYPOTHESES: Mapping[str, Hypothesis] = MappingProxyType({h.name: h for h in _ENTRIES})
