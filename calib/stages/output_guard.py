"""The guard between outputs and everything else: nothing that a user has is overwritten unasked.

An output is never an input of the same command, never inside or above the dataset, never a device,
pipe or other folder, and never a file that somebody else wrote, unless the user forces that one.
A symbolic link is followed first: its target must pass, and is what gets written.
"""

from __future__ import annotations

import stat
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from calib.core.errors import UsageError
from calib.stages.run_folder import wrote_run

DATASET_MARK = "dataset.toml"
"""A folder that holds it is a dataset."""

HEAD_BYTES = 4096
"""Of an existing file, looked at to see who wrote it."""


@dataclass(frozen=True)
class OutputKind:
    """What a command writes, and how to know that an existing one is its own.

    Parameters
    ----------
    is_folder
        Whether it is a folder of files.
    marks
        Of a file: byte strings one of which its first `HEAD_BYTES` hold.
    files
        Of a folder: patterns of names that are written, each with the marks of such a file; one
        without marks goes by its name. A folder is its own if it holds one of them. The first
        pattern that fits a name counts.
    own
        Of a folder: decides in the stead of `files` whether it is its own.
    hidden
        Of a folder: names that do not make it that of somebody else.
    is_dataset
        Whether it is a dataset that is added to, and so may be one already.
    is_new
        Whether it is made anew, where nothing lies but an empty folder.
    """

    is_folder: bool
    marks: tuple[bytes, ...] = ()
    files: tuple[tuple[str, tuple[bytes, ...]], ...] = ()
    own: Callable[[Path], bool] | None = None
    hidden: tuple[str, ...] = ()
    is_dataset: bool = False
    is_new: bool = False

    def wrote(self, path: Path) -> bool:
        """Return whether what lies at `path` was written by the same command."""
        if not self.is_folder:
            return _is_marked(path, self.marks)
        if all(entry.name in self.hidden for entry in path.iterdir()):
            return True
        if self.own is not None:
            return self.own(path)
        found = ((at, marks) for pattern, marks in self.files for at in path.glob(pattern))
        return any(at.is_file() and _is_marked(at, marks, empty=False) for at, marks in found)

    def file(self, name: str) -> OutputKind:
        """Return the kind of a folder's file of that name."""
        marks = next((marks for pattern, marks in self.files if fnmatchcase(name, pattern)), ())
        return OutputKind(is_folder=False, marks=marks)


def _is_marked(path: Path, marks: Sequence[bytes], *, empty: bool = True) -> bool:
    """Return whether a file holds one of the marks, or nothing to lose."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    return (empty and not head) or not (marks or empty) or any(mark in head for mark in marks)


RUN_FOLDER = OutputKind(is_folder=True, own=wrote_run, hidden=(".stages", ".lock"))
NEW_FOLDER = OutputKind(is_folder=True, is_new=True)


def guarded(
    path: Path,
    kind: OutputKind,
    *,
    option: str,
    inputs: Sequence[Path] = (),
    force: bool = False,
) -> Path:
    """Return the real path of an output that may be written.

    Parameters
    ----------
    path
        As the user gave it.
    option
        Name of the argument, for messages.
    inputs
        Files and folders that the same command reads.
    force
        Whether the user agreed to lose a file or fill a folder that another tool wrote.

    Raises
    ------
    UsageError
        If it may not; the message says why and what to do.
    """

    def refuse(why: str, remedy: str) -> UsageError:
        return UsageError(f"{option} {path}: {why}; {remedy}")

    elsewhere = "name another place"
    try:
        real = path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise refuse(f"cannot be followed ({error})", elsewhere) from None
    try:
        _refuse_inputs(real, kind, inputs, refuse)
        if not (real.exists() or real.is_symlink()):
            return real
        mode = real.stat().st_mode
        if kind.is_folder != stat.S_ISDIR(mode):
            what = _kind_of(mode)
            raise refuse(f"is {what}", "name a folder" if kind.is_folder else "name a file")
        if not (kind.is_folder or stat.S_ISREG(mode)):
            raise refuse(f"is {_kind_of(mode)}", "name a file; > redirects to anything else")
        if kind.is_new and (real / DATASET_MARK).exists():
            raise refuse("is a dataset already", "delete it first, or " + elsewhere)
        if kind.is_folder and (real / DATASET_MARK).exists() and not kind.is_dataset:
            raise refuse("is a dataset", "results go into a folder of their own: " + elsewhere)
        if not (force or kind.wrote(real)):
            what = "a folder with files of" if kind.is_folder else "a file of"
            agree = "" if kind.is_new else ", or agree with --force"
            raise refuse(f"is {what} another origin", elsewhere + agree)
    except OSError as error:
        raise refuse(f"cannot be looked at ({error.strerror or error})", elsewhere) from None
    return real


def files_of(
    folder: Path, names: Iterable[str], kind: OutputKind, *, option: str, force: bool = False
) -> dict[str, Path]:
    """Return the real paths of the files that are about to be written into a folder, by name.

    Parameters
    ----------
    folder
        As `guarded` returned it.
    kind
        Of the folder.
    force
        Whether the user agreed to lose files that another tool wrote.

    Raises
    ------
    UsageError
        If one of them is there and was not written by the same command.
    """
    return {
        name: guarded(folder / name, kind.file(name), option=option, force=force) for name in names
    }


def _refuse_inputs(
    real: Path,
    kind: OutputKind,
    inputs: Sequence[Path],
    refuse: Callable[[str, str], UsageError],
) -> None:
    for given in inputs:
        if not given.exists():
            continue
        source = given.resolve()
        if source == real or (real.exists() and source.samefile(real)):
            raise refuse("is an input of the same command", "name another place")
        if not source.is_dir():
            if kind.is_folder and source.is_relative_to(real) and not kind.wrote(real):
                raise refuse(f"holds the input {given}", "name a folder of its own")
            continue
        is_dataset = (source / DATASET_MARK).exists()
        if source.is_relative_to(real) and real.is_dir():
            raise refuse(f"is above {given}, which the command reads", "name a folder of its own")
        if not real.is_relative_to(source):
            continue
        if is_dataset:
            raise refuse(f"lies inside the dataset {given}", "name a place outside of it")
        if real.exists() and (kind.is_folder or not kind.wrote(real)):
            raise refuse(f"is a file of {given}, which the command reads", "name another place")


def _kind_of(mode: int) -> str:
    kinds = (
        (stat.S_ISDIR, "a folder"),
        (stat.S_ISREG, "a file"),
        (stat.S_ISFIFO, "a pipe"),
        (stat.S_ISSOCK, "a socket"),
    )
    return next((name for test, name in kinds if test(mode)), "a device")
