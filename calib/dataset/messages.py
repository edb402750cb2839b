"""Wording of messages: values as they are shown, names as they are suggested."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches

from calib.core.errors import InputError, Problem

SHOWN_LENGTH = 60
"""Characters of an offending value that a message repeats: enough to find it in the file."""

LISTED_PROBLEMS = 10
"""Problems listed for one file. Whoever has more has one cause, and reads the first few."""

# Control characters but tab and line breaks, and halves of surrogate pairs (a file name that is not
# UTF-8): no text editor shows them, XML 1.0 forbids them.
_UNPRINTABLE = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")
# Characters that do not show, or turn the text around them: two ids could look the same. They are
# those of Unicode's Default_Ignorable_Code_Point (https://www.unicode.org/reports/tr44), and others
# without ink.
_INVISIBLE = re.compile(
    "[\u00ad\u034f\u061c\u115f\u1160\u17b4\u17b5\u180b-\u180f\u200b-\u200f\u202a-\u202e\u2060-\u206f"
    "\u2800\u3164\ufe00-\ufe0f\ufeff\uffa0\ufff0-\ufffb\U0001bca0-\U0001bca3"
    "\U0001d173-\U0001d17a\U000e0000-\U000e0fff]"
)
_SIGNED_NUMBER = re.compile(r"[+-][0-9][0-9A-Za-z._-]*")
_LINE_BREAK = re.compile("[\t\n\r\u2028\u2029]")


def shown(value: object) -> str:
    """Return a value as a message repeats it: quoted, escaped, cut to a readable length."""
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    if isinstance(value, bool):
        return str(value).lower()
    # A hostile number may have more digits than Python agrees to print.
    if isinstance(value, int) and value.bit_length() > 4 * SHOWN_LENGTH:
        return f"a whole number of {value.bit_length()} bits"
    if isinstance(value, str):
        value = value[: SHOWN_LENGTH + 1]
    text = repr(value)
    return text if len(text) <= SHOWN_LENGTH else text[:SHOWN_LENGTH] + "…"


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that is most like `name`, whatever its case; None if none is."""
    by_fold = {k.casefold(): k for k in known}
    found = get_close_matches(name[:SHOWN_LENGTH].strip().casefold(), by_fold, n=1)
    return by_fold[found[0]] if found else None


def suggestion(name: str, known: Sequence[str]) -> str:
    """Return the remedy for an unknown name: the nearest known one, or all there are."""
    close = nearest(name, known)
    if close is not None:
        return f"did you mean '{close}'?"
    return f"known here: {', '.join(known)}"


def row_place(file: str, line: int, identity: str, column: str | None = None) -> str:
    """Return the place of a fault in a table: file, line, id and column."""
    place = f"{file}, line {line}"
    if identity:
        place += f" (id {shown(identity).strip(chr(39))})"
    return place if column is None else f"{place}, column {column}"


def same_in_more(rows: int) -> str:
    """Return what is said of the rows that are not named one by one."""
    return f"the same in {rows} more row{'s' * (rows > 1)}"


def text_fault(text: str, *, one_line: bool = True) -> str | None:
    """Return what forbids `text` as a name or a line of a certificate; None if nothing does."""
    if not text.strip():
        return "is empty"
    if found := _UNPRINTABLE.search(text):
        return f"holds the control character U+{ord(found[0]):04X}"
    if found := _INVISIBLE.search(text):
        return f"holds the invisible character U+{ord(found[0]):04X}"
    if one_line and _LINE_BREAK.search(text):
        return "holds a tab or a line break"
    return None


def name_fault(text: str) -> str | None:
    """Return what forbids `text` as a name in a table; None if nothing does.

    Names are written into tables again, and spreadsheets compute a cell that is a formula.
    """
    if fault := text_fault(text):
        return fault
    return "would be a formula in a spreadsheet" if is_formula(text) else None


def is_formula(text: str) -> bool:
    """Return whether a spreadsheet takes a cell for a formula; signed numbers are none."""
    return text.startswith(("=", "@")) or (
        text.startswith(("+", "-")) and _SIGNED_NUMBER.fullmatch(text) is None and len(text) > 1
    )


def shortened(
    problems: Sequence[Problem], *, where: str, total: int | None = None
) -> tuple[Problem, ...]:
    """Return at most `LISTED_PROBLEMS` of one file's problems, and how many more there are.

    `total` is their number where `problems` is already cut.
    """
    more = (total or len(problems)) - LISTED_PROBLEMS
    if more <= 0:
        return tuple(problems)
    rest = Problem(
        where=where,
        what=f"{more} more problem{'s' * (more > 1)}",
        remedy="mend those above first",
    )
    return (*problems[:LISTED_PROBLEMS], rest)


def refuse_if(problems: Sequence[Problem], *, where: str) -> None:
    """Raise one error with all problems of a file; return if there are none.

    Raises
    ------
    InputError
        If there is a problem.
    """
    if problems:
        raise InputError(shortened(problems, where=where))
