"""Small pages of tables and figures: self-contained, no scripts, light and dark."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import TypeAlias

from calib.results.wording import printable


@dataclass(frozen=True)
class Link:
    """A cell that leads to a file; its address is relative to the page."""

    text: str
    address: str


@dataclass(frozen=True)
class StateCell:
    """A cell that says whether something is as it should be."""

    text: str
    good: bool


Cell: TypeAlias = str | Link | StateCell | tuple["str | Link | StateCell", ...]
"""Several in one cell are separated by commas."""


@dataclass(frozen=True)
class PlainTable:
    """A table; a row of one cell is a note on it."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]


@dataclass(frozen=True)
class FigureRow:
    """Figures as SVG elements, a row beside each other as far as the page is wide."""

    title: str
    rows: Sequence[Sequence[str]]
    caption: str = ""


@dataclass(frozen=True)
class Text:
    """Text."""

    text: str


Block: TypeAlias = PlainTable | FigureRow | Text

_STYLE = """
:root { color-scheme: light dark; --line: #d9d9d9; --bad: #a83200; --good: #00664d;
  --cue: rgb(168 50 0 / .5); }
@media (prefers-color-scheme: dark) { :root { --line: #555; --bad: #ff9d70; --good: #5fd3b0;
  --cue: rgb(255 157 112 / .6); } }
body { font: 15px/1.45 "DejaVu Sans", sans-serif; margin: 2em auto; max-width: 70em;
  padding: 0 1em; }
h2 { font-size: 1.05em; margin-bottom: 0; }
/* An edge behind which a table goes on is shaded; lids that scroll along cover it at the end. */
.wide { overflow-x: auto; margin: .6em 0 1.6em; background:
  linear-gradient(to right, Canvas 60%, transparent) 0 / 3em 100% no-repeat local,
  linear-gradient(to left, Canvas 60%, transparent) 100% / 3em 100% no-repeat local,
  linear-gradient(to right, var(--cue), transparent) 0 / 1.2em 100% no-repeat scroll,
  linear-gradient(to left, var(--cue), transparent) 100% / 1.2em 100% no-repeat scroll; }
table { border-collapse: collapse; width: max-content; max-width: max(100%, 58em); }
th, td { padding: .2em .8em .2em 0; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--line); }
.date { white-space: nowrap; }
.bad { color: var(--bad); font-weight: bold; } .good { color: var(--good); }
svg { max-width: 100%; height: auto; background: #fff; }
.drawn { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 19em), 1fr));
  gap: .3em; margin: .3em 0; break-inside: avoid; }
.drawn svg { width: 100%; border-radius: 4px; }
@media print { body { font-size: 11px; margin: 0; } table { width: 100%; max-width: 100%; }
  .wide { overflow: visible; background: none; } .drawn { grid-template-columns: repeat(3, 1fr); }
  tr { break-inside: avoid; } }
"""


def plain_page(title: str, blocks: Sequence[Block], *, generator: str) -> str:
    """Return the page.

    Parameters
    ----------
    generator
        The command that writes it; an output of that name is known by it.
    """
    body = "\n".join(_block(block) for block in blocks)
    return printable(
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        f'<meta name="generator" content="{escape(generator)}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style></head>\n"
        f"<body><h1>{escape(title)}</h1>\n{body}\n</body></html>\n"
    )


def _block(block: Block) -> str:
    match block:
        case Text(text):
            return f"<p>{escape(text)}</p>"
        case FigureRow(title, rows, caption):
            drawn = "\n".join(f'<div class="drawn">{"".join(row)}</div>' for row in rows)
            said = f"<p>{escape(caption)}</p>\n" if caption else ""
            return f"<h2>{escape(title)}</h2>\n{said}{drawn}"
        case PlainTable(title, head, rows):
            lines = [_line(head, "th", len(head)), *(_line(row, "td", len(head)) for row in rows)]
            heading = f"<h2>{escape(title)}</h2>\n" if title else ""
            # Reached by the keyboard, or a wide table could not be moved without a mouse.
            return (
                f'{heading}<div class="wide" tabindex="0" role="region" '
                f'aria-label="{escape(title or "table")}"><table>\n{"".join(lines)}</table></div>'
            )


def _line(cells: Sequence[Cell], kind: str, columns: int) -> str:
    if len(cells) == 1 < columns:
        return f'<tr><{kind} colspan="{columns}">{_cell(cells[0])}</{kind}></tr>\n'
    return (
        "<tr>"
        + "".join(f"<{kind}{_kept(cell)}>{_cell(cell)}</{kind}>" for cell in cells)
        + "</tr>\n"
    )


def _kept(cell: Cell) -> str:
    """Return the class of a cell that holds a date, which is not broken at its hyphens."""
    text = cell.text if isinstance(cell, StateCell) else cell
    return ' class="date"' if isinstance(text, str) and _DATED.fullmatch(text) else ""


_DATED = re.compile(r"(?:\w+ )?\d{4}-\d\d-\d\d")


def _cell(cell: Cell) -> str:
    match cell:
        case tuple():
            return ", ".join(_cell(each) for each in cell)
        case Link(text, address):
            return f'<a href="{escape(address)}">{escape(text)}</a>'
        case StateCell(text, good):
            return f'<span class="{"good" if good else "bad"}">{escape(text)}</span>'
        case str():
            return escape(cell)
