"""Pictures that the manifest leaves out: `exclude` of a camera, of stereo or of the sweep."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePosixPath

from calib.core.errors import Problem
from calib.dataset.messages import nearest, shown


def excluded(
    names: Sequence[str], images: Sequence[str], *, where: str
) -> tuple[frozenset[str], list[Problem]]:
    """Return the images that names leave out, and what is wrong with the names.

    A name is a path relative to the dataset, or the end of one: ``c1/07.png`` is
    ``intrinsics/c1/07.png``.

    Parameters
    ----------
    names
        As the manifest gives them.
    images
        Of the section, relative to the dataset.
    where
        Key of the manifest, for messages.
    """
    out: set[str] = set()
    problems: list[Problem] = []
    for name in names:
        found = [image for image in images if _is_end(name, image)]
        if len(found) == 1:
            out.add(found[0])
        elif found:
            both = " and ".join(shown(image) for image in found[:2])
            problems.append(
                Problem(
                    where=where,
                    what=f"{shown(name)} is the end of {len(found)} names: {both}",
                    remedy="give more of the path, up to the dataset folder",
                )
            )
        else:
            problems.append(
                Problem(
                    where=where,
                    what=f"{shown(name)} is no picture of this section",
                    remedy=_remedy(name, images),
                )
            )
    return frozenset(out), problems


def _is_end(name: str, image: str) -> bool:
    """Whether the parts of a path are the last ones of another."""
    parts, whole = PurePosixPath(name).parts, PurePosixPath(image).parts
    return bool(parts) and whole[-len(parts) :] == parts


def _remedy(name: str, images: Sequence[str]) -> str:
    close = nearest(name, images)
    if close is None:
        ends = {PurePosixPath(image).name: image for image in images}
        end = nearest(PurePosixPath(name).name, list(ends))
        close = None if end is None else ends[end]
    if close is None:
        return "name a picture as the report does, relative to the dataset folder"
    return f"did you mean {shown(close)}?"
