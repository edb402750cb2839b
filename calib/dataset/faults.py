"""From the text of dataset.toml to a manifest, or to its faults in the user's words."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, get_args

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from calib.core.errors import InputError, Problem
from calib.dataset.fields import PRIOR_NAMES, REFUSED
from calib.dataset.folder import decode
from calib.dataset.manifest import Manifest
from calib.dataset.messages import LISTED_PROBLEMS, nearest, shortened, shown, suggestion
from calib.dataset.section import Section

MANIFEST: Final = "dataset.toml"

MANIFEST_LIMIT_BYTES = 64 * 1024
"""Ten times what a manifest with every key and long notes takes."""

LINE_LIMIT = 4000
"""Longest line, in characters. Parsing a dotted key takes the square of its length: one of 64 KiB
takes a minute, one of this length 0.1 s."""

_EXAMPLES: Mapping[str, str] = {
    "format": "format = 1",
    "name": 'name = "my-rig"',
    "table": 'table = "gaze.csv"',
    "type": 'type = "chessboard"',
    "columns": "columns = 9, the inner corners across",
    "rows": "rows = 7, the inner corners down",
    "square_mm": "square_mm = 25.0, the side of a square",
    "resolution_deg": "resolution_deg = 0.05625, one count or microstep",
    "depth_rel": "depth_rel = 0.02, for 2 % of z",
}


@dataclass(frozen=True)
class Parsed:
    """What the text of a manifest yields.

    Parameters
    ----------
    manifest
        None if there is a problem.
    tables
        Relative names of the tables by section, as far as they can be read in spite of problems.
    problems
        All faults of the manifest taken alone.
    is_left, step_deg
        Whether C2 stands at -X of C1, and one count of the encoder, in spite of problems elsewhere.
    """

    manifest: Manifest | None
    tables: Mapping[str, str]
    problems: tuple[Problem, ...]
    is_left: bool = False
    step_deg: float | None = None


def parse_manifest(data: bytes) -> Parsed:
    """Return the manifest in the bytes of a dataset.toml, or its faults; never raises."""
    try:
        text = decode(data, where=MANIFEST)
        raw = parse_toml(text, file=MANIFEST)
    except InputError as error:
        return Parsed(None, {}, error.problems)
    tables = {
        name: section["table"]
        for name in ("gaze", "validation", "sweep", "lengths", "returns")
        if isinstance(section := raw.get(name), dict) and isinstance(section.get("table"), str)
    }
    rig = raw.get("rig")
    is_left = isinstance(rig, dict) and rig.get("c2") == "left"
    encoder = raw.get("encoder")
    step = encoder.get("resolution_deg") if isinstance(encoder, dict) else None
    step_deg = step if isinstance(step, float) and 0 < step < 180 else None
    try:
        return Parsed(Manifest.model_validate(raw), tables, (), is_left, step_deg)
    except ValidationError as error:
        lines = key_lines(text)
        details = error.errors(include_url=False)
        problems = [_translate(d, lines) for d in details[:LISTED_PROBLEMS]]
        told = shortened(problems, where=MANIFEST, total=len(details))
        return Parsed(None, tables, told, is_left, step_deg)


def parse_toml(text: str, *, file: str) -> dict[str, Any]:
    """Return what a TOML text says; `file` is its name, for messages.

    Raises
    ------
    InputError
        If it cannot be read, with the line.
    """
    for number, line in enumerate(text.splitlines(), start=1):
        if len(line) > LINE_LIMIT:
            raise InputError.single(
                where=f"{file}, line {number}",
                what=f"is {len(line)} characters long",
                remedy=f"break it into lines of at most {LINE_LIMIT}",
            )
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise _syntax_error(text, str(error), file) from error


def _syntax_error(text: str, message: str, file: str) -> InputError:
    """Return what is wrong with TOML that cannot be read, with the line it is in."""
    what, where = message, file
    if place := re.search(r" \(at line (\d+), column \d+\)$", message):
        number = int(place[1])
        line = text.replace("\r\n", "\n").split("\n")[number - 1]
        what = f"{message[: place.start()]} in {shown(line.strip())}"
        where = f"{file}, line {number}"
    return InputError.single(
        where=where,
        what=f"is not TOML: {what}",
        remedy="texts and paths are in quotes, decimals have a point, lists are in [ ], "
        "each key occurs once",
    )


_HEADER = re.compile(r"\s*\[+([^\[\]]*)\]")
_KEY = re.compile(r"[\w\"'.\- ]+")
_PLAIN_KEY = re.compile(r"[A-Za-z0-9_-]{1,60}")


def key_lines(text: str) -> dict[tuple[str, ...], int]:
    """Return the line of each key and section that stands on a line of its own."""
    lines: dict[tuple[str, ...], int] = {}
    section: tuple[str, ...] = ()
    quoted = False
    for number, line in enumerate(text.splitlines(), start=1):
        if not quoted:
            if header := _HEADER.match(line):
                section = _parts(header[1])
                lines.setdefault(section, number)
            elif _KEY.fullmatch(key := line.partition("=")[0]):
                lines.setdefault((*section, *_parts(key)), number)
        quoted ^= (line.count('"""') + line.count("'''")) % 2 == 1
    return lines


def _parts(key: str) -> tuple[str, ...]:
    return tuple(part.strip(" \"'") for part in key.split("."))


def _section(path: tuple[str, ...]) -> type[Section] | None:
    """Return the model of a section, None if `path` is not one."""
    model: type[Section] = Manifest
    for name in path:
        field = model.model_fields.get(name)
        if field is None:
            return None
        kinds = get_args(field.annotation) or (field.annotation,)
        found = [k for k in kinds if isinstance(k, type) and issubclass(k, Section)]
        if not found:
            return None
        model = found[0]
    return model


def _translate(error: ErrorDetails, lines: Mapping[tuple[str, ...], int]) -> Problem:
    """Return a fault found by pydantic as a problem."""
    location = [part for part in error["loc"] if part != "[key]"]
    names = tuple(part for part in location if isinstance(part, str))
    items = [part for part in location if isinstance(part, int)]
    if error["type"] == "extra_forbidden":
        what, remedy = _unknown_key(names)
    elif error["type"] == "missing" and not items:
        what = "is missing"
        remedy = f"add {_EXAMPLES.get(names[-1], 'it')}"
    else:
        what, remedy = words(error)
    return Problem(where=_where(names, items, lines), what=what, remedy=remedy)


def _where(names: tuple[str, ...], items: list[int], lines: Mapping[tuple[str, ...], int]) -> str:
    """Return the place of a fault, such as ``dataset.toml, [encoder] resolution_deg (line 9)``."""
    if not names:
        return MANIFEST
    *sections, key = (name if _PLAIN_KEY.fullmatch(name) else shown(name) for name in names)
    if _section(names) is not None or names == ("priors",):
        place = f"[{'.'.join((*sections, key))}]"
    else:
        place = f"[{'.'.join(sections)}] {key}" if sections else key
    labels = ("item",) if len(items) == 1 else ("row", "item")
    place += "".join(f", {label} {i + 1}" for label, i in zip(labels, items, strict=False))
    for depth in range(len(names), 0, -1):
        if names[:depth] in lines:
            return f"{MANIFEST}, {place} (line {lines[names[:depth]]})"
    return f"{MANIFEST}, {place}"


def _unknown_key(names: tuple[str, ...]) -> tuple[str, str]:
    """Return the words for a key that its section does not have."""
    key, section = names[-1], names[:-1]
    model = _section(section) or Manifest
    known = tuple(model.model_fields)
    if nearest(key, known) is None and (home := _home(key)) is not None:
        return f"unknown key {shown(key)}", f"it belongs in [{home}]"
    return f"unknown key {shown(key)}", suggestion(key, known)


def _home(key: str) -> str | None:
    """Return the section that has a key of this name."""
    if key in PRIOR_NAMES:
        return "priors"
    for name in Manifest.model_fields:
        model = _section((name,))
        if model is not None and key in model.model_fields:
            return name
    return None


def words(error: ErrorDetails) -> tuple[str, str]:
    """Return what is wrong with a value that pydantic refused, and the remedy."""
    return _WORDS.get(error["type"], _other)(error)


def _not_a(kind: str, remedy: str) -> Callable[[ErrorDetails], tuple[str, str]]:
    def words(error: ErrorDetails) -> tuple[str, str]:
        value = error["input"]
        if kind in ("a number", "a whole number") and isinstance(value, str):
            return f"{shown(value)} is a text, not {kind}", "write it without quotes, with a point"
        if kind == "a whole number" and isinstance(value, float) and value.is_integer():
            return f"{shown(value)} is not a whole number", f"write {value:.0f}"
        return f"{shown(value)} is not {kind}", remedy

    return words


def _bound(key: str, words: str) -> Callable[[ErrorDetails], tuple[str, str]]:
    def bounded(error: ErrorDetails) -> tuple[str, str]:
        limit = error.get("ctx", {})[key]
        return f"{shown(error['input'])} is out of range", f"give a value {words} {limit:g}"

    return bounded


def _other(error: ErrorDetails) -> tuple[str, str]:
    return error["msg"][:1].lower() + error["msg"][1:], "see datasets/README.md for the format"


def _refused(error: ErrorDetails) -> tuple[str, str]:
    context = error.get("ctx", {})
    return str(context["what"]), str(context["remedy"])


def _literal(error: ErrorDetails) -> tuple[str, str]:
    value, expected = error["input"], str(error.get("ctx", {})["expected"])
    if expected == "1":
        return (
            f"{shown(value)} is not a dataset format that this version of calib reads",
            "write format = 1, or use the version the dataset was made for",
        )
    return f"{shown(value)} is not known here", f"write {expected}"


def _count(error: ErrorDetails) -> tuple[str, str]:
    context = error.get("ctx", {})
    wanted = context.get("max_length", context.get("min_length"))
    return f"has {context.get('actual_length')} values", f"give {wanted}"


_WORDS: Mapping[str, Callable[[ErrorDetails], tuple[str, str]]] = {
    REFUSED: _refused,
    "float_type": _not_a("a number", "write a finite number"),
    "finite_number": _not_a("a finite number", "write a finite number"),
    "int_type": _not_a("a whole number", "write a whole number"),
    "string_type": _not_a("a text", "write it in quotes"),
    "bool_type": _not_a("true or false", "write true or false"),
    "tuple_type": _not_a("a list", "write its values in [ ]"),
    "named_tuple_type": _not_a("a prior", "write [mean, standard deviation]"),
    "dict_type": _not_a("a table", "write it as a table: [section], then its keys"),
    "mapping_type": _not_a("a table", "write it as a table: [section], then its keys"),
    "model_type": _not_a("a table", "write it as a table: [section], then its keys"),
    "model_attributes_type": _not_a("a table", "write it as a table: [section], then its keys"),
    "greater_than": _bound("gt", "above"),
    "greater_than_equal": _bound("ge", "of at least"),
    "less_than": _bound("lt", "below"),
    "less_than_equal": _bound("le", "of at most"),
    "literal_error": _literal,
    "too_long": _count,
    "too_short": _count,
    "missing": lambda _: ("is missing", "give all values of the list"),
}
