"""What can go wrong, each kind with the exit status of the command line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar


def harmless(text: str) -> str:
    """Return a text with its unprintable characters escaped, but for line breaks.

    A file's name may hold escape sequences, which a terminal would obey.
    """
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in text
    )


class CalibError(Exception):
    """Base of the errors raised on purpose: a message for the user, never a traceback."""

    exit_status: ClassVar[int] = 2

    def __str__(self) -> str:
        return harmless(super().__str__())


@dataclass(frozen=True)
class Problem:
    """One fault of the input: where it stands, what it is, what to do.

    Parameters
    ----------
    where
        File, and row or key in it, for example ``gaze.csv, line 4 (id 3), column z_mm``.
    what
        The fault with the offending value.
    remedy
        The next step for the user.
    """

    where: str
    what: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.where}: {self.what}; {self.remedy}"


class InputError(CalibError):
    """The dataset, a table or a result file cannot be used as it is.

    Carries every problem found, so that ``calib check`` can list them all.
    """

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(map(str, self.problems)))

    @classmethod
    def single(cls, *, where: str, what: str, remedy: str) -> InputError:
        """Return an error with one problem."""
        return cls([Problem(where=where, what=what, remedy=remedy)])


class UsageError(CalibError):
    """The command line or the place of the output cannot be used as asked."""


class EstimationError(CalibError):
    """A computation has no answer on these data; the pipeline reports it as a failed gate."""

    exit_status: ClassVar[int] = 3
