"""A dataset's folder that grows, and is whole at every moment.

Pictures come first, then the table that names them, then the manifest that names the table, then a
line in the journal `session.jsonl`. Each file appears or changes by a rename, after its content has
reached the disk. Killed at any moment, the folder lacks at most the row in work.
"""

from __future__ import annotations

import csv
import fcntl
import io
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.core.errors import InputError, UsageError
from calib.dataset.folder import decode
from calib.stages.files import clear_partial, make_folder, opened_lock, write_bytes

MANIFEST: Final = "dataset.toml"
JOURNAL: Final = "session.jsonl"
_LOCK: Final = ".capture.lock"


class GrowingFolder:
    """The folder of a dataset to which rows are added; make one by `growing`."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def picture(self, name: str, pixels: NDArray[np.uint8]) -> None:
        """Write a picture as PNG, without loss; `name` is relative to the folder."""
        done, data = cv2.imencode(".png", pixels)
        if not done:
            raise UsageError(f"{name}: the picture cannot be encoded")
        self._write(name, data.tobytes())

    def pictures(self, under: str) -> list[str]:
        """Return the names of the pictures in a folder below, sorted."""
        return sorted(f"{under}/{path.name}" for path in (self.root / under).glob("[!.]*.png"))

    def next_picture(self, under: str) -> str:
        """Return the name of a picture that is not there yet: numbered, one after the last."""
        numbers = [int(n) for name in self.pictures(under) if (n := Path(name).stem).isdigit()]
        return f"{under}/{max(numbers, default=0) + 1:02d}.png"

    def text(self, name: str) -> str | None:
        """Return the text of a file; None if there is none.

        Raises
        ------
        InputError
            If it cannot be read or is no text.
        """
        try:
            data = (self.root / name).read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InputError.single(
                where=name, what=f"cannot be read ({error.strerror})", remedy="check permissions"
            ) from None
        return decode(data, where=name)

    def write_text(self, name: str, text: str) -> None:
        """Write a text file, whole."""
        self._write(name, text.encode())

    def rows(self, name: str) -> list[dict[str, str]]:
        """Return the rows of a table; none if there is no table.

        Raises
        ------
        InputError
            If a row has more or fewer cells than the table has columns.
        """
        text = self.text(name)
        reader = csv.DictReader(io.StringIO(text or ""))
        rows = []
        for row in reader:
            if None in row or None in row.values():
                raise InputError.single(
                    where=f"{name}, line {reader.line_num}",
                    what=f"does not have the {len(reader.fieldnames or ())} cells of the header",
                    remedy="complete the row, or delete it",
                )
            rows.append(row)
        return rows

    def add_row(self, name: str, columns: Sequence[str], cells: Mapping[str, str]) -> None:
        """Add a row to a table, which is made if there is none.

        Raises
        ------
        InputError
            If the table has other columns.
        """
        rows = self.rows(name)
        head = next(csv.reader(io.StringIO(self.text(name) or "")), None)
        if head is not None and head != list(columns):
            raise InputError.single(
                where=name,
                what=f"has the columns {', '.join(head)}; the capture writes {', '.join(columns)}",
                remedy="capture into a new folder, with the target and reference as before",
            )
        text = io.StringIO()
        writer = csv.DictWriter(text, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows([*rows, dict(cells)])
        self._write(name, text.getvalue().encode())

    def note(self, event: str, **details: Any) -> None:
        """Add a line to the journal."""
        line = json.dumps({"event": event, **details}, allow_nan=False) + "\n"
        try:
            with (self.root / JOURNAL).open("ab") as file:
                file.write(line.encode())
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise UsageError(f"{JOURNAL}: cannot be written ({error.strerror})") from error

    def events(self, event: str) -> list[dict[str, Any]]:
        """Return the journal's entries of a kind; lines that are none are passed over."""
        return [entry for entry in self.all_events() if entry.get("event") == event]

    def all_events(self) -> list[dict[str, Any]]:
        """Return the journal's entries in their order; lines that are none are passed over."""
        found = []
        for line in (self.text(JOURNAL) or "").splitlines():
            try:
                entry = json.loads(line)
            except ValueError:
                continue
            if isinstance(entry, dict):
                found.append(entry)
        return found

    def _write(self, name: str, content: bytes) -> None:
        path = self.root / name
        if path.is_symlink():
            raise UsageError(f"{path}: is a link; the capture writes into its own folder only")
        make_folder(path.parent)
        write_bytes(path, content)
        # The new name reaches the disk with its folder.
        handle = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)

    def clear_away(self) -> None:
        """Delete what a capture that was killed left half-written, and end its journal's line."""
        for folder in (self.root, *(p for p in self.root.rglob("*") if p.is_dir())):
            clear_partial(folder)
        journal = self.root / JOURNAL
        if journal.exists() and not journal.read_bytes().endswith((b"\n", b"")[:1]):
            whole, _, _ = journal.read_bytes().rpartition(b"\n")
            write_bytes(journal, whole + b"\n" if whole else b"")


@contextmanager
def growing(root: Path) -> Iterator[GrowingFolder]:
    """Open a folder to add to; another capture is kept out meanwhile.

    Raises
    ------
    UsageError
        If it cannot be made, or another capture writes to it.
    """
    make_folder(root)
    with opened_lock(root / _LOCK) as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise UsageError(f"{root}: another capture is writing there; wait for it") from None
        folder = GrowingFolder(root)
        folder.clear_away()
        yield folder
