"""What a certificate is made from: frozen, and free of any wording."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

from calib.core.gate import Gate
from calib.uncertainty.evidence import Evidence
from calib.uncertainty.measurement import Instrument
from calib.uncertainty.montecarlo import Interval

PREFIX = "AG"
"""Identifiers start with it: active gazing."""


@dataclass(frozen=True)
class Administration:
    """What the manifest says in [certificate]; None where it is silent.

    Parameters
    ----------
    laboratory, address
        Who calibrates, and where they live.
    customer
        Name and contact.
    instrument, serial, condition
        The item, its serial number, its state on receipt.
    received
        Date (ISO 8601) on which the item was received.
    location, date
        Place and date (ISO 8601) of the calibration.
    operator, approved_by
        Who calibrated, and who authorises the certificate.
    temperature_c, humidity_percent
        Conditions.
    deviations
        Additions to, deviations or exclusions from the method.
    country
        Two capitals, ISO 3166-1, for the DCC.
    replaces, amendment
        Identifier of the certificate this one replaces, and why.
    next_calibration
        Recommended date (ISO 8601), only where the customer has asked for one.
    """

    laboratory: str | None = None
    address: str | None = None
    customer: str | None = None
    instrument: str | None = None
    serial: str | None = None
    condition: str | None = None
    received: str | None = None
    location: str | None = None
    date: str | None = None
    operator: str | None = None
    approved_by: str | None = None
    temperature_c: float | None = None
    humidity_percent: float | None = None
    deviations: str | None = None
    country: str | None = None
    replaces: str | None = None
    amendment: str | None = None
    next_calibration: str | None = None


@dataclass(frozen=True)
class Issue:
    """Identifier and date of issue (ISO 8601, UTC) of one certificate."""

    identifier: str
    issued: str


@dataclass(frozen=True)
class CertificateProvenance:
    """Data and software behind the certificate.

    Parameters
    ----------
    dataset_name, dataset_title, dataset_sha256
        The dataset.
    calibration_sha256
        Of the bytes of the calibration.json that is certified.
    citation
        Where its data come from; None if not stated.
    seed
        Of all random numbers.
    software
        Name and version, calib first.
    commit
        Of calib; None outside a repository.
    """

    dataset_name: str
    dataset_title: str
    dataset_sha256: str
    calibration_sha256: str
    citation: str | None
    seed: int
    software: tuple[tuple[str, str], ...]
    commit: str | None


@dataclass(frozen=True)
class DerivedQuantity:
    """A quantity that follows from the parameters.

    Parameters
    ----------
    name, meaning, unit
        As printed.
    value, std
        With its standard uncertainty, in `unit`.
    interval
        Its 95 % interval, in `unit`; None where there are no draws of the parameters.
    """

    name: str
    meaning: str
    unit: str
    value: float
    std: float
    interval: Interval | None = None


@dataclass(frozen=True)
class CalibrationSummary:
    """The calibration that is certified.

    Parameters
    ----------
    model
        Name of the selected model.
    instrument
        Parameters with their joint distribution, and the errors of a reading.
    identified_by
        "data", "prior" or "both", one a parameter.
    estimator
        How the parameters were found, as printed.
    rows, outliers
        Number of calibration rows, and ids of those that disagree with the others.
    reference
        What the reference depths are; None if not stated.
    calibrated_mm
        Least and greatest reference depth.
    noise_factor
        Factor by which the stated uncertainties of a reading were widened, 1 if not.
    derived
        Further quantities.
    intrinsics
        Where the intrinsics of C1 come from, as printed; None if not stated.
    """

    model: str
    instrument: Instrument
    identified_by: tuple[str, ...]
    estimator: str
    rows: int
    outliers: tuple[str, ...]
    reference: str | None
    calibrated_mm: tuple[float, float]
    noise_factor: float = 1.0
    derived: tuple[DerivedQuantity, ...] = ()
    intrinsics: str | None = None


@dataclass(frozen=True)
class CertificateInputs:
    """All of it.

    Parameters
    ----------
    gates
        Checks of the calibration; if one failed the certificate says that it must not be used.
    warnings
        What the reader should know and no gate covers.
    """

    administration: Administration
    issue: Issue
    provenance: CertificateProvenance
    calibration: CalibrationSummary
    evidence: Evidence
    gates: tuple[Gate, ...] = ()
    warnings: tuple[str, ...] = ()


def new_issue(*, now: datetime, dataset_sha256: str, token: str) -> Issue:
    """Return identifier and date of a new certificate.

    The identifier holds the second, the dataset and `token`, so that neither two runs in one
    second nor one run on two machines repeat it.

    Parameters
    ----------
    now
        Aware time of issue.
    token
        Hexadecimal digits from a source that does not repeat, 12 of them or more: for example
        ``secrets.token_hex(6)``. Not from the seed: equal seeds issue different certificates.

    Raises
    ------
    ValueError
        If the time has no zone, or the token is too short or not hexadecimal.
    """
    if now.tzinfo is None:
        raise ValueError("the time of issue needs a time zone")
    if len(token) < 12 or not set(token) <= set("0123456789abcdef"):
        raise ValueError("the token needs 12 hexadecimal digits or more")
    moment = now.astimezone(UTC)
    identifier = "-".join([PREFIX, moment.strftime("%Y%m%dT%H%M%SZ"), dataset_sha256[:8], token])
    return Issue(identifier=identifier.upper(), issued=moment.date().isoformat())
