"""The parts a report is made of: plain data, laid out by the template.

Texts are escaped when they are printed, unless they are `Markup`, which only this project's own
words become: `Markup.format` escapes what it is given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from markupsafe import Markup

Text: TypeAlias = str | Markup


@dataclass(frozen=True)
class Cell:
    """An entry of a table.

    Parameters
    ----------
    text
        As printed.
    key
        What it sorts by, with all digits; None to sort by the text.
    numeric
        Whether it is aligned as a number.
    mark
        "good", "bad", "caution" or "quiet"; empty for none.
    """

    text: Text
    key: float | None = None
    numeric: bool = False
    mark: str = ""


@dataclass(frozen=True)
class Table:
    """A table: `head` names the columns, with units; `sortable` where rows have no order.

    A `dense` one has so many columns that it takes smaller letters to show them all.
    """

    caption: Text
    head: tuple[Text, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: Text = ""
    sortable: bool = False
    dense: bool = False
    kind: Literal["table"] = field(default="table", init=False)


@dataclass(frozen=True)
class Paragraph:
    """A paragraph."""

    text: Text
    kind: Literal["paragraph"] = field(default="paragraph", init=False)


@dataclass(frozen=True)
class Items:
    """A list."""

    items: tuple[Text, ...]
    kind: Literal["items"] = field(default="items", init=False)


@dataclass(frozen=True)
class DefinitionList:
    """Pairs of a label and a value."""

    facts: tuple[tuple[Text, Text], ...]
    kind: Literal["facts"] = field(default="facts", init=False)


@dataclass(frozen=True)
class KeyFigures:
    """The few figures to see first: label, value, remark; greyed where they are `void`."""

    tiles: tuple[tuple[Text, Text, Text], ...]
    void: bool = False
    kind: Literal["tiles"] = field(default="tiles", init=False)


@dataclass(frozen=True)
class Notice:
    """A verdict or a warning that must not be overlooked; `caution` is amber."""

    mark: Literal["good", "bad", "caution", "note"]
    title: Text
    text: Text = ""
    kind: Literal["notice"] = field(default="notice", init=False)


@dataclass(frozen=True)
class CommandLine:
    """A command to type."""

    text: str
    kind: Literal["command"] = field(default="command", init=False)


@dataclass(frozen=True)
class Picture:
    """A figure on the page.

    Parameters
    ----------
    key
        Its anchor and the name of its data file; unique.
    image, width_px
        Data URI, and the width it is drawn for.
    alternative
        What it shows, for those who cannot see it.
    caption
        What is drawn, and what a fault would look like.
    data
        Data URI of a CSV file; empty where there is none.
    points
        Places and words of its points, JSON; see `calib.report.hover`.
    """

    key: str
    image: str
    width_px: int
    alternative: str
    caption: Text
    data: str
    points: str
    kind: Literal["picture"] = field(default="picture", init=False)


@dataclass(frozen=True)
class Scene:
    """The rig to be turned and looked at; `data` is JSON of `calib.report.scene`."""

    key: str
    data: str
    caption: Text
    kind: Literal["scene"] = field(default="scene", init=False)


@dataclass(frozen=True)
class Thumbnail:
    """A small picture: data URI, name, what found its board; `fault`, if any, frames it.

    `remark` are its residuals in figures.
    """

    image: str
    name: str
    detector: str
    fault: str = ""
    remark: str = ""


@dataclass(frozen=True)
class PictureSheet:
    """A contact sheet; `key` is its anchor."""

    key: str
    caption: Text
    pictures: tuple[Thumbnail, ...]
    kind: Literal["sheet"] = field(default="sheet", init=False)


@dataclass(frozen=True)
class Fold:
    """Blocks behind one line, open or not; print shows them all."""

    summary: Text
    blocks: tuple[Block, ...]
    is_open: bool = False
    kind: Literal["fold"] = field(default="fold", init=False)


Block: TypeAlias = (
    Table
    | Paragraph
    | Items
    | DefinitionList
    | KeyFigures
    | Notice
    | CommandLine
    | Picture
    | PictureSheet
    | Scene
    | Fold
)


@dataclass(frozen=True)
class Chapter:
    """A chapter of the report; `key` is its anchor; one that `is_open` is not folded at first."""

    key: str
    title: str
    blocks: tuple[Block, ...]

    @property
    def is_open(self) -> bool:
        """Whether it is read by everybody."""
        return self.key in OPEN


OPEN = ("verdict", "validation")
"""Sections that are not folded: what is stated, and what an independent reference says of it."""


def number(text: str, value: float, *, mark: str = "") -> Cell:
    """Return a cell that prints `text` and sorts by `value`."""
    return Cell(text, key=float(value), numeric=True, mark=mark)


def words(text: Text, *, mark: str = "") -> Cell:
    """Return a cell of text."""
    return Cell(text, mark=mark)


def facts(*pairs: tuple[Text, Text]) -> DefinitionList:
    """Return labels and values; those without a value are left out."""
    return DefinitionList(tuple((label, value) for label, value in pairs if value))


EMPTY = Cell("–", numeric=True, mark="quiet")
"""A cell without a value in a column of numbers."""

NOTHING = Cell("–", mark="quiet")
"""A cell without a value in a column of words."""


def table(
    caption: Text,
    head: Sequence[Text],
    rows: Sequence[Sequence[Cell]],
    *,
    note: Text = "",
    sortable: bool = False,
    dense: bool = False,
) -> Table:
    """Return a table.

    Raises
    ------
    ValueError
        If a row has not one cell a column.
    """
    if any(len(row) != len(head) for row in rows):
        raise ValueError(f"table {caption!r}: a row does not fit its {len(head)} columns")
    return Table(caption, tuple(head), tuple(map(tuple, rows)), note, sortable, dense)
