"""All that a certificate prints, with every string decided: the three forms only lay it out.

Numbers are strings, rounded once; minus signs are ASCII, so that a program reads what a person
reads.
"""

from __future__ import annotations

from dataclasses import dataclass

from calib.uncertainty.conformity import Verdict

NONE = "-"
"""Of a cell that has nothing to say."""


@dataclass(frozen=True)
class CertificateField:
    """A field of the certificate: label and value."""

    label: str
    value: str


@dataclass(frozen=True)
class Result:
    """A number with its uncertainty.

    Parameters
    ----------
    name, meaning
        As printed.
    unit
        "mm", "mrad" or "1".
    value, standard_uncertainty
        The latter None where none exists.
    expanded_uncertainty, coverage_factor
        U and k; None where there is no interval, k also where no u exists.
    from_interval
        Whether U is half the interval and k = U / u, as from the Monte Carlo distribution; else U
        is k u and the interval value ± U.
    low, high
        Ends of the 95 % interval; None where none is stated.
    remark
        What decided it, or by which way it was found.
    """

    name: str
    meaning: str
    unit: str
    value: str
    standard_uncertainty: str | None
    expanded_uncertainty: str | None
    coverage_factor: str | None
    from_interval: bool
    low: str | None
    high: str | None
    remark: str


@dataclass(frozen=True)
class Region:
    """A position with its 95 % ellipsoid.

    Parameters
    ----------
    position
        x, y, z.
    uncertainty
        u of each.
    correlation
        r_xy, r_xz, r_yz.
    covariance
        Rows of the covariance matrix, mm².
    coverage_factor
        Of the ellipsoid.
    semi_axes, longest_axis
        Lengths, mm, and the direction of the longest.
    """

    position: tuple[str, str, str]
    uncertainty: tuple[str, str, str]
    correlation: tuple[str, str, str]
    covariance: tuple[tuple[str, ...], ...]
    coverage_factor: str
    semi_axes: tuple[str, str, str]
    longest_axis: tuple[str, str, str]


@dataclass(frozen=True)
class Judgement:
    """A statement of conformity: limit, probability in per cent, T / U, verdict and warning."""

    limit: str
    probability: str
    ratio: str
    verdict: Verdict
    words: str
    warning: str | None


@dataclass(frozen=True)
class BudgetLine:
    """A line of an uncertainty budget of a length in mm.

    Parameters
    ----------
    quantity, unit
        As printed; "mm", "mrad" or "1".
    estimate, standard_uncertainty
        In `unit`.
    evaluation, distribution, freedom
        Type A or B, name, degrees of freedom.
    sensitivity, contribution, share
        mm per `unit`; mm; per cent.
    numbers
        Sensitivity and contribution with as many digits, as programs read them.
    of_parameters
        Whether it is one of the parameters, which have lines however small their shares are.
    share_percent
        The share, not rounded.
    """

    quantity: str
    unit: str
    estimate: str
    standard_uncertainty: str
    evaluation: str
    distribution: str
    freedom: str
    sensitivity: str
    contribution: str
    share: str
    numbers: tuple[str, str]
    of_parameters: bool
    share_percent: float


@dataclass(frozen=True)
class DepthLine:
    """A certified depth.

    Parameters
    ----------
    depth
        The result.
    ray
        x1c of the ray.
    relative
        Larger side of the interval, per cent of depth, rounded up.
    judgement
        None without a tolerance.
    extrapolated
        Whether it lies outside the calibrated range.
    region
        Position.
    contributions
        Sources of the standard uncertainty by the linear law, each with its contribution, mm.
    budget
        Its lines.
    """

    depth: Result
    ray: str
    relative: str
    judgement: Judgement | None
    extrapolated: bool
    region: Region
    contributions: tuple[CertificateField, ...]
    budget: tuple[BudgetLine, ...]


@dataclass(frozen=True)
class AnnexTable:
    """A table of an annex.

    Parameters
    ----------
    title
        Caption.
    columns
        Headings with units.
    rows
        Cells.
    note
        Below the table; empty for none.
    words
        Columns that hold words and not numbers, by place.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    words: tuple[int, ...] = (0,)


@dataclass(frozen=True)
class Annex:
    """A titled part after the two pages."""

    title: str
    introduction: str
    tables: tuple[AnnexTable, ...]


@dataclass(frozen=True)
class Matrix:
    """A covariance matrix: names, printed units, and rows with ten significant digits."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Figure:
    """A picture (SVG) with the text that stands for it."""

    svg: str
    alternative: str
    caption: str


@dataclass(frozen=True)
class Conclusion:
    """Conformity over the whole calibrated range; `verdict` None if no statement is made."""

    verdict: Verdict | None
    words: str
    basis: str


@dataclass(frozen=True)
class CertificateData:
    """The certificate.

    Parameters
    ----------
    title, subtitle, identifier, issued
        Heading.
    replaces, amendment
        Identifier of the certificate replaced and the reason; None if it replaces none.
    prohibition
        Why the certificate must not be used; None if all checks passed.
    cautions
        What to know before use.
    laboratory, address, customer, item, serial, condition, received, place, operator, approved_by,
    method, conditions, traceability, deviations
        Fields; "not stated" where the manifest is silent.
    temperature_c, humidity_percent
        Numbers as strings; None if not stated.
    calibrated, performed
        Date as printed, and the date the DCC gives: that of issue where none is stated.
    country
        Two capitals; "ZZ" where none is stated.
    summary
        The result in a sentence.
    depths, parameters, covariance, conclusion, rule, tolerance
        Results; `tolerance` None if none was stated.
    check_summary, length_summary
        Sentences; None without such data.
    checks, lengths
        Results with their judgements in `checks`; lengths as errors.
    statements
        What ISO/IEC 17025 asks to be said.
    figure
        Of the depth uncertainty; None without a certified depth.
    annexes
        After the two pages.
    software
        Name and version.
    dataset, sha256, calibration_sha256
        What it was computed from.
    """

    title: str
    subtitle: str
    identifier: str
    issued: str
    replaces: str | None
    amendment: str | None
    prohibition: str | None
    cautions: tuple[str, ...]
    laboratory: str
    address: str
    customer: str
    item: str
    serial: str
    condition: str
    received: str
    place: str
    operator: str
    approved_by: str
    method: str
    conditions: str
    traceability: str
    deviations: str
    temperature_c: str | None
    humidity_percent: str | None
    calibrated: str
    performed: str
    country: str
    summary: str
    depths: tuple[DepthLine, ...]
    parameters: tuple[Result, ...]
    covariance: Matrix
    conclusion: Conclusion
    rule: str
    tolerance: str | None
    check_summary: str | None
    length_summary: str | None
    checks: tuple[tuple[Result, Judgement | None], ...]
    lengths: tuple[Result, ...]
    statements: tuple[CertificateField, ...]
    figure: Figure | None
    annexes: tuple[Annex, ...]
    software: tuple[tuple[str, str], ...]
    dataset: str
    sha256: str
    calibration_sha256: str

    @property
    def fields(self) -> tuple[tuple[CertificateField, ...], ...]:
        """The administrative fields in the lines of the first page, one or two a line."""
        return (
            (CertificateField("Laboratory", self.laboratory),),
            (CertificateField("Address", self.address),),
            (CertificateField("Customer", self.customer),),
            (CertificateField("Item calibrated", self.item),),
            (
                CertificateField("Serial number", self.serial),
                CertificateField("Condition", self.condition),
            ),
            (
                CertificateField("Place of calibration", self.place),
                CertificateField("Conditions", self.conditions),
            ),
            (
                CertificateField("Date of receipt", self.received),
                CertificateField("Date of calibration", self.calibrated),
            ),
            (
                CertificateField("Date of issue", self.issued),
                CertificateField("Deviations", self.deviations),
            ),
            (
                CertificateField("Calibrated by", self.operator),
                CertificateField("Authorised by", self.approved_by),
            ),
            (CertificateField("Method", self.method),),
            (CertificateField("Traceability", self.traceability),),
        )
