"""standard.toml read."""

from __future__ import annotations

import tomllib
from pathlib import Path

from pydantic import ValidationError

from calib.core.errors import InputError, Problem
from calib.core.limited import TooLargeError, read_limited
from calib.history.certified import Standard

LIMIT_BYTES = 1_000_000
"""Ten thousand certified lengths."""

EXAMPLE = 'format = 1, serial = "bar-3", and [[length]] with between = ["A", "B"], length_mm, u_mm'


def read_standard(path: Path) -> Standard:
    """Return the check standard that a file describes.

    Raises
    ------
    InputError
        If it cannot be read, is no TOML or says something else.
    """
    try:
        content = tomllib.loads(read_limited(path, LIMIT_BYTES).decode("utf-8"))
    except TooLargeError:
        raise _bad(path, "is too large for a check standard", f"write {EXAMPLE}") from None
    except OSError as error:
        raise _bad(path, f"cannot be read ({error.strerror or error})", "give its path") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise _bad(path, f"is no TOML ({error})", f"write {EXAMPLE}") from None
    try:
        standard = Standard.model_validate(content)
    except ValidationError as error:
        raise InputError(
            [
                Problem(f"{path}, {'.'.join(map(str, one['loc']))}", one["msg"], f"write {EXAMPLE}")
                for one in error.errors()
            ]
        ) from None
    _refuse_contradiction(path, standard)
    return standard


def _refuse_contradiction(path: Path, standard: Standard) -> None:
    if not standard.quantities:
        raise _bad(path, "certifies nothing", "add [[length]] or [[depth]]")
    for target in standard.gazed:
        if target not in standard.targets:
            raise _bad(path, f"[targets] {target} is in no length or depth", "leave it out")
    for one in standard.length:
        if one.between[0] == one.between[1]:
            raise _bad(path, f"{one.name} has one end", "name two targets")
    names = [one.name for one in standard.quantities]
    for name in names:
        if names.count(name) > 1:
            raise _bad(path, f"{name} is there twice", "keep one")


def _bad(path: Path, what: str, remedy: str) -> InputError:
    return InputError.single(where=str(path), what=what, remedy=remedy)
