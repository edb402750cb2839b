"""What is stated of the accuracy: certified depths, independent checks, errors of length."""

from __future__ import annotations

from dataclasses import dataclass

from calib.uncertainty.certified import CertifiedDepth, CheckedDepth
from calib.uncertainty.conformity import ToleranceRule
from calib.uncertainty.lengths import LengthError, LengthLimit


@dataclass(frozen=True)
class NotCertified:
    """A depth of which no uncertainty can be stated, and why."""

    depth_mm: float
    reason: str


@dataclass(frozen=True)
class Evidence:
    """What was found out about the accuracy.

    Parameters
    ----------
    depths
        Certified depths, nearest first.
    not_certified
        Depths without an upper limit.
    checks, check_reference
        Measured depths against a reference that the calibration has not seen, and what it is.
    lengths, length_limit
        Measured lengths against reference lengths; None without lengths.
    tolerance
        None where the manifest states none.
    """

    depths: tuple[CertifiedDepth, ...]
    not_certified: tuple[NotCertified, ...] = ()
    checks: tuple[CheckedDepth, ...] = ()
    check_reference: str | None = None
    lengths: tuple[LengthError, ...] = ()
    length_limit: LengthLimit | None = None
    tolerance: ToleranceRule | None = None
