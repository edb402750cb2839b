"""The pictures of a dataset, by their headers: whole, of one size a camera, none too large."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from calib.core.errors import Problem
from calib.dataset.contents import Dataset
from calib.dataset.faults import MANIFEST
from calib.dataset.folder import reason
from calib.dataset.manifest import CAMERAS
from calib.dataset.messages import shortened
from calib.dataset.picture_header import Header, header_fault, picture_header


def picture_faults(dataset: Dataset, root: Path, there: Collection[str]) -> Iterator[Problem]:
    """Yield pictures that cannot be used; nothing is decoded.

    Parameters
    ----------
    root
        The dataset's folder.
    there
        Pictures that exist; those with known corners are not looked at.
    """
    for camera in CAMERAS:
        names = [n for n in _of(dataset, camera) if n in there and n not in dataset.corner_cache]
        yield from shortened(
            list(_faults(dataset, root, camera, names)), where=f"images of {camera}"
        )


def with_sizes(dataset: Dataset, root: Path, there: Collection[str]) -> Dataset:
    """Return the dataset with the image size of each camera whose manifest leaves it to its images.

    Parameters as `picture_faults`.
    """
    update = {}
    for name in CAMERAS:
        section = dataset.manifest.camera(name)
        if section is None or section.images is None or section.image_size is not None:
            continue
        headers = (_header(root / n) for n in _of(dataset, name) if n in there)
        first = next((header for header in headers if header is not None), None)
        if first is not None:
            size = first.width, first.height
            update[name] = section.model_copy(update={"image_size": size})
    if not update:
        return dataset
    cameras = dataset.manifest.cameras.model_copy(update=update)
    return replace(dataset, manifest=dataset.manifest.model_copy(update={"cameras": cameras}))


def _header(path: Path) -> Header | None:
    try:
        with path.open("rb") as file:
            return picture_header(file)
    except OSError:
        return None


def missing_sizes(dataset: Dataset) -> Iterator[Problem]:
    """Yield cameras whose image size neither manifest nor pictures say."""
    for name in CAMERAS:
        section = dataset.manifest.camera(name)
        if section is not None and section.images is not None and section.image_size is None:
            yield Problem(
                f"{MANIFEST}, [cameras.{name}] image_size",
                "is missing, and no image of the camera is there to take it from",
                "add image_size = [width, height] in pixels",
            )


def _of(dataset: Dataset, camera: str) -> Iterable[str]:
    """Return the pictures of a camera, each once."""
    which = CAMERAS.index(camera)
    named = [*dataset.images.get(camera, ()), *(p[which] for p in dataset.stereo_pairs.values())]
    tables = (*dataset.rows, *((dataset.sweep,) if dataset.sweep is not None else ()))
    for table in tables:
        named += [name for name in getattr(table, f"image_{camera}", ()) if name]
    return dict.fromkeys(named)


def _faults(dataset: Dataset, root: Path, camera: str, names: list[str]) -> Iterator[Problem]:
    section = dataset.manifest.camera(camera)
    wanted = None if section is None else section.image_size
    by = "the manifest says"
    if wanted is None and camera in dataset.cameras:
        wanted, by = dataset.cameras[camera].image_size, "the camera's model says"
    for name in names:
        try:
            with (root / name).open("rb") as file:
                header = picture_header(file)
        except OSError as error:
            yield Problem(name, f"cannot be read ({reason(error)})", "check its permissions")
            continue
        fault = header_fault(header)
        if fault is not None:
            yield Problem(name, *fault)
            continue
        if header is None:
            continue
        size = header.width, header.height
        if wanted is None:
            wanted, by = size, f"{name} is"
        elif size != wanted:
            yield Problem(
                name,
                f"the image is {size[0]} x {size[1]} px and {by} {wanted[0]} x {wanted[1]}",
                "correct image_size, or take out images of another camera or mode",
            )
