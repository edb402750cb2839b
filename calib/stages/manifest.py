"""The manifest of a run's outputs: digests written last and read first.

While outputs are written the manifest says that they are not complete; so a kill or a full disk at
any moment leaves a set of files that is known to be broken, never one that passes for a run. A file
under the name of an output that the manifest does not list belongs to no run. A copy of one file
elsewhere has no manifest, and is taken by itself.
"""

from __future__ import annotations

import json
import stat
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

from calib.core.errors import InputError, Problem, UsageError
from calib.core.mrcal_python import mrcal_identity
from calib.stages.files import CACHE, write_bytes
from calib.stages.fingerprint import digest, whole_code
from calib.stages.provenance import direct_packages
from calib.stages.run_folder import ALWAYS, FORMER, MANIFEST, SOMETIMES, json_object

FORMAT = 1

AGAIN = "run calib calibrate again"


def run_fingerprint(dataset_sha256: str, options: Mapping[str, Any]) -> str:
    """Return what all outputs of a run depend on: data, options, code, package versions."""
    return digest(dataset_sha256, dict(options), whole_code(), direct_packages(), mrcal_identity())


def begin_outputs(out: Path, names: Iterable[str]) -> None:
    """Say that the outputs of a run are being written.

    Parameters
    ----------
    names
        Of the files to come.

    Raises
    ------
    UsageError
        If one of them is there and is no file of an earlier run, or another would pass for one.
    """
    document = json_object(out / MANIFEST)
    known, names = {str(name) for name in _files(document)}, tuple(names)
    for name in SOMETIMES:
        if (out / name).exists() and name not in known and name not in names:
            raise UsageError(
                f"{out / name}: would pass for an output of this run; move it, or choose another "
                "--out"
            )
    for name in names:
        path = out / name
        if path.is_symlink() or (path.exists() and not path.is_file()):
            raise UsageError(f"{path}: is no plain file; move it, or choose another --out")
        if document is not None and path.exists() and name not in known:
            raise UsageError(
                f"{path}: is no file of the run that {out} holds, and would be replaced; move it, "
                "or choose another --out"
            )
    files = dict.fromkeys(sorted(known | set(names)))
    _write(out, {"format": FORMAT, "complete": False, "files": files})
    (out / FORMER).unlink(missing_ok=True)


def end_outputs(out: Path, fingerprint: str, names: Iterable[str]) -> None:
    """Say that the outputs of a run are whole, and what they are."""
    files = {name: _digest(out / name) for name in names}
    _write(out, {"format": FORMAT, "complete": True, "fingerprint": fingerprint, "files": files})


def _write(out: Path, document: Mapping[str, Any]) -> None:
    write_bytes(out / MANIFEST, (json.dumps(document, indent=1) + "\n").encode())


def finished_before(out: Path, fingerprint: str) -> bool:
    """Return whether the folder holds all files of a run with this fingerprint, untouched."""
    document = json_object(out / MANIFEST)
    return document is not None and document.get("fingerprint") == fingerprint and not faults(out)


def faults(out: Path) -> tuple[Problem, ...]:
    """Return what is wrong with the outputs in the folder of a run; nothing if they are whole."""
    document = json_object(out / MANIFEST)
    unfinished = _unfinished(out, document)
    if document is None or unfinished is not None:
        return () if unfinished is None else (unfinished,)
    files, found = _files(document), []
    for name in (*ALWAYS, *SOMETIMES):
        if name not in files and (name in ALWAYS or (out / name).exists()):
            what = f"is not listed in {MANIFEST}: it is of no run, or the manifest was edited"
            found.append(Problem(str(out / name), what, AGAIN))
    for name, wanted in files.items():
        try:
            if _digest(out / name) != wanted:
                what = "is not what the run wrote (its SHA-256 differs from that in the manifest)"
                found.append(Problem(str(out / name), what, AGAIN))
        except OSError as error:
            what = f"cannot be read ({error.strerror or error})"
            found.append(Problem(str(out / name), what, AGAIN))
    return tuple(found)


def _unfinished(out: Path, document: Mapping[str, Any] | None) -> Problem | None:
    """Return what is wrong with a manifest itself."""
    if document is None:
        what = "is missing or damaged: the run that wrote this folder did not finish"
        return Problem(str(out / MANIFEST), what, f"{AGAIN}, with --force")
    if type(document.get("format")) is not int or document["format"] != FORMAT:
        what = f"format {document.get('format')!r} is not known"
        return Problem(str(out / MANIFEST), what, f"format {FORMAT} is; {AGAIN}")
    if document.get("complete") is not True:
        what = "the run that wrote this folder did not finish: its files may be of two runs"
        return Problem(str(out), what, AGAIN)
    return None


@dataclass(frozen=True)
class Listing:
    """What the manifest of a run's folder says, read once for all files of the folder."""

    folder: Path
    document: Mapping[str, Any] | None

    @classmethod
    def of(cls, folder: Path) -> Listing | None:
        """Return that of a folder; None if the folder is not that of a run."""
        return cls(folder, json_object(folder / MANIFEST)) if is_run(folder) else None

    @cached_property
    def _listed(self) -> dict[str, Any]:
        return _files(self.document)

    def refuse_broken(self, name: str, content: bytes, *, edited: bool = False) -> None:
        """Raise as the function of this name does, for a file that is no link."""
        if (unfinished := _unfinished(self.folder, self.document)) is not None:
            raise InputError((unfinished,))
        if name not in (*ALWAYS, *SOMETIMES, *self._listed) or edited:
            return
        if self._listed.get(name) != sha256(content).hexdigest():
            raise InputError.single(
                where=str(self.folder / name),
                what="is not what the run wrote: it was edited, or is of another run than the "
                "certificate beside it",
                remedy=f"{AGAIN}, or use it as it is with --allow-edited",
            )


def refuse_broken(file: Path, content: bytes, *, edited: bool = False) -> None:
    """Raise if a file lies in the folder of a run that is not whole, or is not the run's.

    A link is followed: the folder that its target lies in counts, too.

    Parameters
    ----------
    file
        An output that is about to be used; one that lies elsewhere is not looked into.
    content
        Its bytes, as they are about to be used.
    edited
        Whether the user wants the file although it was edited.

    Raises
    ------
    InputError
        Naming it, with the remedy.
    """
    for place in dict.fromkeys((file, file.resolve())):
        if (listing := Listing.of(place.parent)) is not None:
            listing.refuse_broken(place.name, content, edited=edited)


def refuse_broken_folder(folder: Path) -> None:
    """Raise if a folder holds a run whose outputs are not whole and untouched.

    Raises
    ------
    InputError
        Naming each file.
    """
    if is_run(folder) and (found := faults(folder)):
        raise InputError(found)


def is_run(folder: Path) -> bool:
    """Return whether a folder is that of a run that has a manifest, or should have one."""
    if (folder / MANIFEST).exists():
        return True
    return (folder / CACHE).exists() and not (folder / FORMER).exists()


def _files(document: Mapping[str, Any] | None) -> dict[str, Any]:
    files = None if document is None else document.get("files")
    if not isinstance(files, dict):
        return {}
    return {name: value for name, value in files.items() if Path(name).name == name}


def _digest(path: Path) -> str:
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError("it is no plain file")
    with path.open("rb") as file:
        found = sha256()
        while chunk := file.read(1 << 20):
            found.update(chunk)
    return found.hexdigest()
