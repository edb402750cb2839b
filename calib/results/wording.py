"""Texts of the certificate, and how texts of others are made fit to print."""

from __future__ import annotations

import re

from calib.rows.observations import GROUP_SOURCE
from calib.uncertainty.conformity import DecisionRule, Verdict

NOT_STATED = "not stated"

TITLE = "Calibration certificate"
SUBTITLE = "Depth and position measurement by active object gazing"

RELATES = "The results relate only to the item calibrated."
REPRODUCTION = (
    "This certificate shall not be reproduced except in full without the written approval of the "
    "issuing laboratory."
)
NO_ACCREDITATION = (
    "No accreditation is claimed: the certificate follows ISO/IEC 17025:2017, 7.8.2 and 7.8.4, in "
    "its fields, and was issued by a computer program from the data named in it."
)
NEXT_CALIBRATION = "Next calibration, recommended at the customer's request"

STABILITY = (
    "The results hold for the state of the item on the date of calibration. Nothing is said of its "
    "long-term stability."
)
ADJUSTMENT = (
    "The calibration determines parameters by which readings are evaluated; it adjusts nothing on "
    "the item."
)
ONE_READING = (
    "The uncertainty is that of one reading of a target gazed at, at the stated depth, at the ray "
    "of the field of view where it is largest. It holds the uncertainty of the calibration and of "
    "the reading; it holds no error of the reference beyond its stated uncertainty, and none of "
    "the target."
)
LINEAR_MEANING = (
    "U is the standard uncertainty u multiplied by the coverage factor k, which for the effective "
    "degrees of freedom gives a coverage probability of 95 %."
)
MONTE_CARLO_MEANING = (
    "Where k is marked MC, the interval is the shortest one of 95 % probability from the Monte "
    "Carlo distribution of JCGM 101, U is half of it and k = U / u: there the first-order law of "
    "propagation has no valid coverage factor, or clause 8 of JCGM 101 did not validate it. Such "
    "an interval need not be symmetric about the value: the interval counts."
)
NO_TOLERANCE = "No tolerance was stated; no statement of conformity is made."
WITHHELD = "No statement of conformity is made, because a check of the calibration failed."
EXTRAPOLATED = "extrapolated"
LENGTHS_NOTE = (
    "Error of length in the manner of VDI/VDE 2634 part 1. That guideline's acceptance test was "
    "not carried out and no conformity with it is claimed. A + K·L is the least line above every "
    "|error| + U, for lengths L within the range tested."
)

CAMERA_LINES = (
    "Intrinsics and pose of the cameras were estimated once: their errors are common to all rows "
    "and readings. Each source of them has one line, a correction of 0 mm, with what it does to "
    "the depth by parameters and reading together; the later ones stand for what the earlier do "
    "not explain of them. Beside these lines, u of a parameter is what rows and prior knowledge "
    "leave; the table of the parameters and their covariance hold the cameras' part as well."
)

GROUP_LINE = (
    f"Several rows have their reference depth from one measurement. The line {GROUP_SOURCE!r} is "
    "what it adds to the uncertainty of the parameters that such rows have a common error, not "
    "independent ones; a reading has no part in it."
)

NORMS = (
    "ISO/IEC 17025:2017, 7.8.2 and 7.8.4 (fields)",
    "JCGM 100:2008",
    "JCGM 101:2008",
    "JCGM 102:2011",
    "JCGM 106:2012",
)
METHOD_REFERENCE = "doi 10.1177/1729881417715984"

RULES: dict[DecisionRule, str] = {
    "simple": (
        "Decision rule: simple acceptance (ILAC-G8:09/2019, 4.2.1): an error within the tolerance "
        "passes, up to 50 % risk of a wrong statement at its limit. Where U exceeds the tolerance "
        "the statement is a conditional pass at best."
    ),
    "guard-band": (
        "Decision rule: guard band g = 1.645 u, 95 % one-sided (JCGM 106:2012, 8.3.2; "
        "ILAC-G8:09/2019, 4.2.3): pass up to tolerance - g, conditional pass up to the tolerance, "
        "conditional fail up to tolerance + g, fail beyond. A pass has a probability of "
        "conformance of 95 % or more."
    ),
}

VERDICTS: dict[Verdict, str] = {
    "pass": "pass",
    "conditionalPass": "conditional pass",
    "conditionalFail": "conditional fail",
    "fail": "fail",
}

MODELS: dict[str, str] = {
    "base": "two parameters: baseline and encoder zero",
    "axis-offset": "base with the yaw axis offset in depth and the gaze plane offset from it",
    "axis-tilt": "axis-offset with a tilted yaw axis and a rolled gazing camera",
    "encoder": "axis-offset with scale and once-per-turn errors of the encoder",
}

# What XML 1.0 forbids (control characters, halves of surrogate pairs, noncharacters), and what
# turns the direction of the text around it: a serial number must read as it is written.
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")
_TURNING = re.compile("[\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    """Return a text without characters that cannot be printed or turn their neighbours around.

    They show as the replacement character: that something stood there must not be hidden.
    """
    return _TURNING.sub("\ufffd", _FORBIDDEN.sub("\ufffd", text))


def sentence(text: str) -> str:
    """Return a text as a sentence: with a capital and a full stop."""
    text = text[:1].upper() + text[1:]
    return text if text.endswith((".", "!", "?")) else f"{text}."


def clean(text: str | None) -> str:
    """Return a text of the manifest as it is printed, on one line; "not stated" without one."""
    return NOT_STATED if text is None else " ".join(printable(text).split()) or NOT_STATED
