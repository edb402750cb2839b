"""A check standard: targets of certified length or depth, measured between calibrations.

A calibration is rare and a rig may be knocked any day. Whoever measures the same standard each
morning sees it: ILAC-G24:2022 / OIML D 10, method 4 (in-service checking). All measurements use one
calibration, so its error is common to all of them: what is charted is what changes, against the
uncertainty of the readings alone, and whether the standard agrees with its certificate is a
question of its own, answered with everything.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, time

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from calib.core.arrays import FloatArray
from calib.core.errors import InputError, Problem
from calib.dataset.readings import ReadingBlock, read_blocks
from calib.history.charts import Chart, charts, reference
from calib.history.quantities import Series
from calib.instrument.calibration_file import Measuring
from calib.instrument.measuring import Measured, measure

DATE, TARGET = "date", "id"

COVERAGE = 1.96
"""Of the 95 % intervals that a deviation from the certificate is held against."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Length(_Section):
    """A certified distance of two targets, and its standard uncertainty, mm."""

    between: tuple[str, str]
    length_mm: float = Field(gt=0)
    u_mm: float = Field(ge=0)

    @property
    def name(self) -> str:
        """As printed."""
        return f"length {self.between[0]} to {self.between[1]}"


class Depth(_Section):
    """A known depth of a target in frame C1, and its standard uncertainty, mm."""

    target: str
    z_mm: float = Field(gt=0)
    u_mm: float = Field(ge=0)

    @property
    def name(self) -> str:
        """As printed."""
        return f"depth of {self.target}"


class Standard(_Section):
    """A check standard, as standard.toml describes it."""

    format: int = Field(ge=1, le=1)
    serial: str = Field(min_length=1)
    length: tuple[Length, ...] = ()
    depth: tuple[Depth, ...] = ()

    @property
    def quantities(self) -> tuple[Length | Depth, ...]:
        """All that is certified."""
        return (*self.length, *self.depth)

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of all targets, each once."""
        ends = [end for one in self.length for end in one.between]
        return tuple(dict.fromkeys([*ends, *(one.target for one in self.depth)]))


@dataclass(frozen=True)
class Session:
    """The targets as read at one time.

    Parameters
    ----------
    date
        ISO 8601, as the table has it.
    at
        Place of each target among the measured rows, by name.
    """

    date: str
    at: dict[str, int]


@dataclass(frozen=True)
class Checked:
    """A standard measured again and again with one calibration; q quantities, n sessions.

    Parameters
    ----------
    names, dates
        Of quantities and sessions.
    values
        As measured, mm, shape (n, q).
    readings
        Covariance of the quantities of a session by its readings alone, shape (n, q, q), mm^2.
    std
        Standard uncertainty with everything but the certificate's own, shape (n, q).
    certified, u_certified
        Values on the certificate and their standard uncertainties, shape (q,).
    standard
        What is measured.
    targets_mm
        Where its targets were measured, in the order of `Standard.targets`, shape (n, t, 3).
    theta
        Parameters of the calibration, as `calib.geometry.parameters` orders them.
    """

    names: tuple[str, ...]
    dates: tuple[str, ...]
    values: FloatArray
    readings: FloatArray
    std: FloatArray
    certified: FloatArray
    u_certified: FloatArray
    standard: Standard
    targets_mm: FloatArray
    theta: FloatArray

    @property
    def normalised(self) -> FloatArray:
        """Deviations from the certificate over the 95 % uncertainty of the two, shape (n, q)."""
        expanded = COVERAGE * np.hypot(self.std, self.u_certified)
        found: FloatArray = (self.values - self.certified) / expanded
        return found

    def series(self) -> tuple[Series, ...]:
        """Return the quantities over time, with the uncertainty of their readings."""
        std = np.sqrt(np.diagonal(self.readings, axis1=1, axis2=2))
        return tuple(
            Series(name, "mm", self.dates, self.values[:, k], std[:, k])
            for k, name in enumerate(self.names)
        )


SINGULAR = 1e-9
"""Smallest ratio of eigenvalues of what is not linearly dependent."""


def check_standard(measuring: Measuring, standard: Standard, text: str, *, name: str) -> Checked:
    """Return what a calibration makes of the readings of a standard.

    Parameters
    ----------
    text
        A table with the columns of `calib measure` (``id`` is the target) and ``date``; targets
        read at one date are one session.
    name
        Of the table, for messages.

    Raises
    ------
    InputError
        If the table is none, a reading cannot be measured, or a session lacks a target.
    """
    block = _block(text, name)
    measured = measure(measuring, block.table)
    _refuse_faults(block, measured, name)
    sessions = _sessions(block, standard, name)
    _refuse_one_place(measured, standard, sessions, name)
    found = [_quantities(measured, standard, one) for one in sessions]
    certified = [
        (q.length_mm if isinstance(q, Length) else q.z_mm, q.u_mm) for q in standard.quantities
    ]
    return Checked(
        names=tuple(q.name for q in standard.quantities),
        dates=tuple(one.date for one in sessions),
        values=np.array([values for values, _, _ in found]),
        readings=np.array([readings for _, readings, _ in found]),
        std=np.array([std for _, _, std in found]),
        certified=np.array([value for value, _ in certified]),
        u_certified=np.array([u for _, u in certified]),
        standard=standard,
        targets_mm=np.array(
            [[measured.position_mm[one.at[n]] for n in standard.targets] for one in sessions]
        ),
        theta=measuring.instrument.theta,
    )


def first_alarm(one: Series, accepted: int) -> tuple[int | None, tuple[Chart, ...]]:
    """Return the first session outside the limits of any chart, and the charts."""
    at = reference(one.values[:accepted], one.std[:accepted])
    found = charts(one.values[accepted:], one.std[accepted:], at)
    alarms = [accepted + chart.first_alarm for chart in found if chart.first_alarm is not None]
    return (min(alarms) if alarms else None), found


def degrees_of_freedom(checked: Checked) -> int:
    """Return of how much the quantities tell independently: some lengths follow from others."""
    return int(np.linalg.matrix_rank(checked.readings[0], rtol=SINGULAR, hermitian=True))


def inverse(matrices: FloatArray) -> FloatArray:
    """Return the inverse, of what is linearly dependent the pseudo-inverse."""
    return np.asarray(np.linalg.pinv(matrices, rcond=SINGULAR, hermitian=True), dtype=np.float64)


def mean_of(checked: Checked, of: slice) -> tuple[FloatArray, FloatArray]:
    """Return the weighted mean of sessions and its covariance by the readings."""
    weights = inverse(checked.readings[of])
    covariance = inverse(weights.sum(axis=0))
    return covariance @ np.einsum("nij,nj->i", weights, checked.values[of]), covariance


def _block(text: str, name: str) -> ReadingBlock:
    """Return the rows, each with an id of its own: target and date."""
    try:
        records = list(csv.reader(io.StringIO(text.removeprefix("\ufeff"))))
    except csv.Error as error:
        raise InputError.single(
            where=name, what=f"is no table ({error})", remedy="save it as CSV UTF-8"
        ) from None
    header = [cell.strip() for cell in records[0]] if records else []
    for column in (DATE, TARGET):
        if header.count(column) != 1:
            raise InputError.single(
                where=name, what=f"has no column {column}", remedy=f"add {column} to its header"
            )
    date, target = header.index(DATE), header.index(TARGET)
    problems, out = [], io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([cell for k, cell in enumerate(header) if k != date])
    for line, cells in enumerate(records[1:], 2):
        record = cells
        if len(record) == len(header):
            given, one = record[date].strip(), record[target].strip()
            day = _one_spelling(given)
            if day is None:
                problems.append(
                    Problem(
                        f"{name}, line {line}, column {DATE}",
                        f"{given!r} is no date", "write 2026-01-31 or 2026-01-31T08:00, local time",
                    )
                )  # fmt: skip
            named = [*record[:target], f"{one} {day}", *record[target + 1 :]]
            record = [cell for k, cell in enumerate(named) if k != date]
        writer.writerow(record)
    if "depth_row" in header:
        raise InputError.single(
            where=name,
            what="has the column depth_row",
            remedy="leave it out: targets have depths of their own",
        )
    if problems:
        raise InputError(problems)
    (block,) = read_blocks(iter([out.getvalue()]), name=name, whole=True)
    return block


def _one_spelling(text: str) -> str | None:
    """Return a date, or date and time, as this program writes it; None if it is neither.

    The same time spelt in two ways is one session, not two.
    """
    try:
        at = datetime.fromisoformat(text)
    except ValueError:
        return None
    if at.tzinfo is not None:
        return None
    midnight = at.time() == time.min
    return at.date().isoformat() if midnight else at.isoformat()


def _sessions(block: ReadingBlock, standard: Standard, name: str) -> tuple[Session, ...]:
    by_date: dict[str, dict[str, int]] = {}
    problems = []
    for row, place in enumerate(block.place.tolist()):
        target, _, date = block.ids[place].rpartition(" ")
        session = by_date.setdefault(date, {})
        if target in session:
            where = f"{name}, line {block.lines[place]}"
            what = f"{target} is read twice at {date}"
            problems.append(Problem(where, what, "give each session a time, as 2026-01-31T08:00"))
        session[target] = row
    problems += [
        Problem(f"{name}, {date}", f"{target} is not read", "read it, or leave out the session")
        for date, at in by_date.items()
        for target in standard.targets
        if target not in at
    ]
    if problems:
        raise InputError(problems)
    ordered = sorted(by_date, key=datetime.fromisoformat)
    return tuple(Session(date, by_date[date]) for date in ordered)


def _refuse_faults(block: ReadingBlock, measured: Measured, name: str) -> None:
    faults = block.faults | {int(block.place[i]): why for i, why in measured.faults.items()}
    if faults:
        raise InputError(
            [
                Problem(f"{name}, line {block.lines[i]} ({block.ids[i]})", why, "read it again")
                for i, why in sorted(faults.items())
            ]
        )


def _refuse_one_place(
    measured: Measured, standard: Standard, sessions: Sequence[Session], name: str
) -> None:
    """Raise if both ends of a length were read at one place: it has no direction, and no u."""
    problems = [
        Problem(
            f"{name}, {session.date}",
            f"{' and '.join(one.between)} have the same readings",
            "read each of them, or leave out the session",
        )
        for session in sessions
        for one in standard.length
        if np.array_equal(*(measured.position_mm[session.at[end]] for end in one.between))
    ]
    if problems:
        raise InputError(problems)


def _quantities(
    measured: Measured, standard: Standard, session: Session
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values, their covariance by readings alone, and their whole standard uncertainty."""
    by_reading, by_common = [], []
    own = measured.by_depth_row.shape[2]
    place = {target: k for k, target in enumerate(standard.targets)}
    for quantity in standard.quantities:
        row = np.zeros((len(place), own))
        if isinstance(quantity, Depth):
            at = session.at[quantity.target]
            row[place[quantity.target]] = measured.by_depth_row[at, 2]
            common = measured.by_common[at, 2]
        else:
            start, end = (session.at[target] for target in quantity.between)
            across = measured.position_mm[end] - measured.position_mm[start]
            along: FloatArray = across / float(np.linalg.norm(across))
            for target, at, sign in zip(quantity.between, (start, end), (-1, 1), strict=True):
                row[place[target]] = sign * (along @ measured.by_depth_row[at])
            common = along @ (measured.by_common[end] - measured.by_common[start])
        by_reading.append(row.ravel())
        by_common.append(common)
    sensitivities, shared = np.array(by_reading), np.array(by_common)
    readings = sensitivities @ sensitivities.T
    common = np.diag(shared @ measured.common @ shared.T)
    values = values_of(measured.position_mm, standard, session.at)
    return values, readings, np.sqrt(np.diag(readings) + common)


def values_of(position_mm: FloatArray, standard: Standard, at: Mapping[str, int]) -> FloatArray:
    """Return the certified quantities, mm, shape (q,), of targets whose places are given."""
    found = []
    for quantity in standard.quantities:
        if isinstance(quantity, Depth):
            found.append(position_mm[at[quantity.target], 2])
        else:
            start, end = (position_mm[at[target]] for target in quantity.between)
            found.append(np.linalg.norm(end - start))
    return np.array(found)
