"""The dataset's folder: what lies inside it, read within limits.

Nothing outside the folder is read, whatever the manifest says: not by an absolute path, not by
`..`, not by a symbolic link. Only regular files are opened: a pipe would never end.
"""

from __future__ import annotations

import glob
import hashlib
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath

from calib.core.errors import InputError, Problem
from calib.dataset.messages import LISTED_PROBLEMS, nearest, shown, text_fault

MIB = 1024 * 1024
TABLE_LIMIT_BYTES = 64 * MIB
"""A million gaze rows. Reading a table takes some fifteen times its size in memory."""

HASH_CHUNK_BYTES = MIB

WILD_PARTS = 2
"""Parts of a pattern that may hold wildcards: links that lead in a circle cannot multiply then."""

_INSIDE = "put the file into the dataset folder and give its path relative to it"


@dataclass(frozen=True)
class Folder:
    """A dataset's folder.

    Parameters
    ----------
    root
        Its real path, links resolved.
    """

    root: Path

    @classmethod
    def open(cls, path: Path) -> Folder:
        """Return the folder at `path`.

        Raises
        ------
        InputError
            If there is none.
        """
        try:
            root = path.resolve(strict=True)
            is_folder = root.is_dir()
        except (OSError, ValueError, RuntimeError) as error:
            raise InputError.single(
                where=shown(str(path)),
                what=f"cannot be opened ({reason(error)})",
                remedy="give the folder that holds dataset.toml",
            ) from error
        if not is_folder:
            raise InputError.single(
                where=str(path),
                what="is a file, not a dataset folder",
                remedy="give the folder that holds dataset.toml",
            )
        if not os.access(root, os.R_OK | os.X_OK):
            raise InputError.single(
                where=str(path),
                what="cannot be read (permission denied)",
                remedy="check the permissions of the folder",
            )
        return cls(root)

    def file(self, name: str, *, where: str) -> Path:
        """Return the path of a regular file inside the folder, links resolved.

        Raises
        ------
        InputError
            If `name` is no such file; `where` says who named it.
        """
        if fault := path_fault(name):
            raise InputError.single(where=where, what=fault, remedy=_INSIDE)
        try:
            path = (self.root / name).resolve()
            inside = path.is_relative_to(self.root)
            exists, regular, folder = path.exists(), path.is_file(), path.is_dir()
        except (OSError, ValueError, RuntimeError) as error:
            denied = isinstance(error, PermissionError)
            raise InputError.single(
                where=where,
                what=f"{shown(name)} cannot be read ({reason(error)})",
                remedy="check the permissions of its folder" if denied else _INSIDE,
            ) from error
        if not inside:
            raise InputError.single(
                where=where,
                what=f"{shown(name)} is a symbolic link that leads out of the dataset folder",
                remedy="copy the file itself into the dataset folder",
            )
        if not exists:
            raise InputError.single(
                where=where,
                what=f"there is no file {shown(name)} in the dataset folder",
                remedy=self._alternative(name),
            )
        if not regular:
            kind = "a folder" if folder else "neither a file nor a folder"
            raise InputError.single(
                where=where, what=f"{shown(name)} is {kind}", remedy="name a file"
            )
        return path

    def _alternative(self, name: str) -> str:
        """Return the remedy for a missing file: the one with the nearest name, if any."""
        parent = (self.root / name).parent
        try:
            siblings = [entry.name for entry in parent.iterdir()]
        except OSError:
            return f"there is no folder {shown(str(PurePosixPath(name).parent))} either"
        close = nearest(PurePosixPath(name).name, siblings)
        if close is None:
            return "check the name, and that the file was copied"
        return f"did you mean {shown(str(PurePosixPath(name).with_name(close)))}?"

    def read(self, name: str, *, limit: int, where: str) -> bytes:
        """Return the bytes of a file inside the folder.

        Raises
        ------
        InputError
            If there is no such file, or it is larger than `limit` bytes.
        """
        path = self.file(name, where=where)
        try:
            with path.open("rb") as stream:
                data = stream.read(limit + 1)
        except OSError as error:
            raise InputError.single(
                where=where,
                what=f"{shown(name)} cannot be read ({reason(error)})",
                remedy="check its permissions",
            ) from error
        if len(data) > limit:
            raise InputError.single(
                where=where,
                what=f"{shown(name)} is larger than {size_text(limit)}",
                remedy="check that it is the file you meant",
            )
        return data

    def expand(self, pattern: str, *, where: str) -> tuple[str, ...]:
        """Return the files that match a pattern, sorted, relative to the folder.

        Raises
        ------
        InputError
            If the pattern leaves the folder, or a match does.
        """
        fault = path_fault(pattern)
        parts = PurePosixPath(pattern).parts
        if fault is None and "**" in pattern:
            fault = f"{shown(pattern)} has '**', which is no wildcard here: it would match like '*'"
        elif fault is None and sum(map(glob.has_magic, parts)) > WILD_PARTS:
            fault = f"{shown(pattern)} has wildcards in more than {WILD_PARTS} places"
        if fault is not None:
            remedy = "give a pattern like 'intrinsics/c1/*.png', relative to the dataset folder"
            raise InputError.single(where=where, what=fault, remedy=remedy)
        found: list[str] = []
        problems: list[Problem] = []
        # Unlike Path.glob this passes over hidden files, such as macOS leaves beside images.
        names = glob.glob(pattern, root_dir=self.root)  # noqa: PTH207 - see above
        for name in sorted(names):
            if (self.root / name).is_dir():
                continue
            try:
                self.file(name, where=where)
            except InputError as error:
                problems.extend(error.problems)
            else:
                found.append(name)
        if problems:
            raise InputError(problems[:LISTED_PROBLEMS])
        return tuple(found)

    def near_pattern(self, pattern: str) -> str:
        """Return the remedy for a pattern that matches nothing."""
        parent = PurePosixPath(pattern).parent
        if glob.has_magic(str(parent)):
            return "check the pattern"
        try:
            suffixes = {e.suffix for e in (self.root / parent).iterdir() if e.is_file()}
        except PermissionError:
            return f"the folder {shown(str(parent))} cannot be read: check its permissions"
        except OSError:
            return f"there is no folder {shown(str(parent))}: copy the images there"
        if not suffixes:
            return f"the folder {shown(str(parent))} is empty: copy the images there"
        return (
            f"the folder {shown(str(parent))} holds files that end in {', '.join(sorted(suffixes))}"
        )

    def digests(self, contents: Mapping[str, bytes], files: Iterable[str]) -> dict[str, str]:
        """Return the SHA-256, in hex, of files by their names.

        Parameters
        ----------
        contents
            Files already read, by relative name: these very bytes are what counts.
        files
            Relative names of further files, read here in pieces.
        """
        digests = {name: hashlib.sha256(data).hexdigest() for name, data in contents.items()}
        for name in set(files) - digests.keys():
            digests[name] = self._digest(name)
        return digests

    def _digest(self, name: str) -> str:
        digest = hashlib.sha256()
        try:
            with self.file(name, where=name).open("rb") as stream:
                while chunk := stream.read(HASH_CHUNK_BYTES):
                    digest.update(chunk)
        except OSError as error:
            raise InputError.single(
                where=name, what=f"cannot be read ({reason(error)})", remedy="check its permissions"
            ) from error
        return digest.hexdigest()


def fingerprint(digests: Mapping[str, str]) -> str:
    """Return the SHA-256, in hex, of files by their names and digests."""
    listing = "".join(f"{digests[name]} {name}\n" for name in sorted(digests))
    return hashlib.sha256(listing.encode()).hexdigest()


def path_fault(name: str) -> str | None:
    """Return what forbids `name` as a path inside the dataset; None if nothing does."""
    if fault := text_fault(name):
        return f"the path {shown(name)} {fault}"
    if "\\" in name:
        return f"the path {shown(name)} has backslashes: write '/'"
    path = PurePosixPath(name)
    if path.is_absolute() or (len(name) > 1 and name[1] == ":"):
        return f"{shown(name)} is an absolute path"
    if ".." in path.parts:
        return f"{shown(name)} leads out of the dataset folder"
    return None


def matches(name: str, pattern: str) -> bool:
    """Return whether a relative path matches a pattern, folder by folder."""
    parts, globs = PurePosixPath(name).parts, PurePosixPath(pattern).parts
    return len(parts) == len(globs) and all(map(fnmatchcase, parts, globs))


def by_star(names: Iterable[str], pattern: str) -> dict[str, str]:
    """Return names by what the stars of the pattern's file name stand for, if these differ."""
    parts = [re.escape(part) for part in PurePosixPath(pattern).name.split("*")]
    form = re.compile("(.*)".join(parts))
    found: dict[str, str] = {}
    twice: set[str] = set()
    for name in names:
        matched = form.fullmatch(PurePosixPath(name).name)
        if matched is None or not matched.groups():
            continue
        key = "-".join(matched.groups())
        twice |= {key} if key in found else set()
        found[key] = name
    return {key: name for key, name in found.items() if key not in twice}


def decode(data: bytes, *, where: str) -> str:
    """Return the text of a UTF-8 file, without the mark that some editors put before it.

    Raises
    ------
    InputError
        If it is not UTF-8 text.
    """
    remedy = "save it as plain text in UTF-8 (in a spreadsheet: 'CSV UTF-8')"
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError.single(where=where, what="is UTF-16, not UTF-8", remedy=remedy)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError.single(
            where=f"{where}, line {line}",
            what=f"is not UTF-8: byte 0x{data[error.start]:02X}",
            remedy=remedy,
        ) from error
    if "\x00" in text:
        raise InputError.single(where=where, what="holds NUL bytes: not a text file", remedy=remedy)
    return text


def reason(error: Exception) -> str:
    """Return the plain reason of a failed file operation."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return text[:1].lower() + text[1:]


def size_text(size: int) -> str:
    """Return a size in bytes as people write it."""
    return f"{size // MIB} MiB" if size >= MIB else f"{size // 1024} KiB"
