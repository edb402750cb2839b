"""What must hold between the parts of a dataset, and what makes one doubt it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import Problem
from calib.dataset.cells import NAMED_ROWS
from calib.dataset.contents import Dataset
from calib.dataset.depth_origin import ahead_of_c1
from calib.dataset.faults import MANIFEST
from calib.dataset.manifest import CAMERAS
from calib.dataset.messages import nearest, row_place, shown
from calib.dataset.tables import GazeTable, LengthTable
from calib.geometry.camera import on_centre_row, without_ray
from calib.geometry.parameters import MODELS

MIN_VIEWS = 6
"""Views of the board that a camera's intrinsics need: three would do without distortion."""

SPARE_ROWS = 3
"""Gaze rows beyond the number of free parameters, which tell how well the model fits."""

MIN_ROWS = SPARE_ROWS + min(len(model.free) for model in MODELS.values())


def faults(dataset: Dataset, *, rows_to_come: bool = False) -> Iterator[Problem]:
    """Yield what must be mended before the dataset can be calibrated.

    Parameters
    ----------
    rows_to_come
        Whether gaze rows are still to be taken: few or none are no fault then.
    """
    yield from _missing_sections(dataset)
    yield from _other_side(dataset)
    yield from _two_serials(dataset)
    yield from _too_few_images(dataset)
    if not rows_to_come:
        yield from _too_few_rows(dataset)
    yield from _missing_groups(dataset)
    yield from _unknown_pairs(dataset)
    yield from _unknown_ends(dataset)
    yield from _pixels_outside(dataset)
    yield from _pixels_without_ray(dataset)


def _other_side(dataset: Dataset) -> Iterator[Problem]:
    """Yield a pose that puts C2 on the other side of C1 than the manifest says."""
    stereo, prior = dataset.manifest.stereo, dataset.manifest.priors.get("baseline_mm")
    places: list[tuple[str, float, str]] = []
    if stereo is not None and stereo.transform is not None:
        remedy = "give the pose of C2 in C1: the inverse of OpenCV's R, T, which map C1 to C2"
        places.append(("[stereo] transform", stereo.transform[0][3], remedy))
    if prior is not None:
        places.append(("[priors] baseline_mm", prior.mean, "give the X of the yaw axis, signed"))
    stands, other = ("-X", "right") if dataset.manifest.rig.is_left else ("+X", "left")
    for place, x, remedy in places:
        if (x < 0) != dataset.manifest.rig.is_left or x == 0:
            yield Problem(
                where=f"{MANIFEST}, {place}",
                what=f"it puts C2 at X = {x:g} mm of C1, but C2 stands on the {stands} side",
                remedy=f"{remedy}; or, if C2 does stand on the {other} of C1, write "
                f'c2 = "{other}" in [rig]',
            )


def _two_serials(dataset: Dataset) -> Iterator[Problem]:
    """Yield serial numbers of rig and certificate that contradict each other."""
    rig, certificate = dataset.manifest.rig.serial, dataset.manifest.certificate.serial
    if rig is not None and certificate is not None and rig != certificate:
        yield Problem(
            where=f"{MANIFEST}, [certificate] serial",
            what=f"{shown(certificate)} is not the serial of [rig], {shown(rig)}",
            remedy="state it once, in [rig]",
        )


@dataclass(frozen=True)
class _Uses:
    """Which sections of a dataset are used, and by what."""

    pixels_c1: bool
    pixels_c2: bool
    images_c1: bool
    images_c2: bool
    intrinsic: bool
    stereo: bool
    pairs: bool
    sweep: bool
    rows: bool

    @classmethod
    def of(cls, dataset: Dataset) -> _Uses:
        manifest, rows = dataset.manifest, dataset.rows
        cameras = (manifest.camera(name) for name in CAMERAS)
        return cls(
            pixels_c1=any(np.isfinite(t.u1_px).any() for t in rows),
            pixels_c2=any(np.isfinite(t.u2_px).any() for t in rows),
            images_c1=any(name is not None for t in rows for name in t.image_c1),
            images_c2=any(name is not None for t in rows for name in t.image_c2),
            intrinsic=any(c is not None and c.images is not None for c in cameras),
            stereo=manifest.stereo is not None,
            pairs=manifest.stereo is not None and manifest.stereo.has_images,
            sweep=manifest.sweep is not None,
            rows=manifest.gaze is not None or manifest.validation is not None,
        )

    def reasons(self, section: str) -> list[str]:
        """Return what needs a section."""
        images = {"image_c1": self.images_c1, "image_c2": self.images_c2, "[sweep]": self.sweep}
        needs = {
            "[cameras.c1]": {
                "u1_px": self.pixels_c1,
                "image_c1": self.images_c1,
                "[stereo]": self.stereo,
            },
            "[cameras.c2]": {
                "u2_px": self.pixels_c2,
                "image_c2": self.images_c2,
                "[stereo]": self.stereo,
                "[sweep]": self.sweep,
            },
            "[board]": {
                "images of a camera": self.intrinsic,
                "images of [stereo]": self.pairs,
                **images,
            },
            "[encoder]": {"[gaze]": self.rows, "[sweep]": self.sweep},
        }
        return [name for name, needed in needs[section].items() if needed]


def _missing_sections(dataset: Dataset) -> Iterator[Problem]:
    """Yield sections that something in the dataset needs."""
    manifest, uses = dataset.manifest, _Uses.of(dataset)
    present = {
        "[cameras.c1]": manifest.cameras.c1,
        "[cameras.c2]": manifest.cameras.c2,
        "[board]": manifest.board,
        "[encoder]": manifest.encoder,
    }
    missing = {name: uses.reasons(name) for name, found in present.items() if found is None}
    if manifest.gaze is None:
        sections = {"[validation]": manifest.validation, "[lengths]": manifest.lengths}
        missing["[gaze]"] = [name for name, found in sections.items() if found is not None]
    for name, reasons in missing.items():
        if reasons:
            yield Problem(
                where=MANIFEST,
                what=f"section {name} is missing; {' and '.join(reasons)} cannot do without",
                remedy="add it; datasets/README.md shows one",
            )
    yield from _origin_of_mixed_depths(dataset)
    yield from _missing_target(dataset, by_rows=uses.images_c1 or uses.images_c2)


def _origin_of_mixed_depths(dataset: Dataset) -> Iterator[Problem]:
    """Yield a table of which some depths count from C1 and others from an uncertain place."""
    gaze, stated = dataset.gaze, dataset.manifest.gaze
    if gaze is None or stated is None:
        return
    known = ~np.isnan(gaze.z_mm)
    certain = stated.origin is not None and ahead_of_c1(stated.z_from)[1] == 0
    if known.any() and any(gaze.stereo) and not certain:
        yield Problem(
            where=f"{MANIFEST}, [gaze] z_from",
            what=f"is uncertain, and {gaze.file} has depths by image pairs beside z_mm",
            remedy="state from where z_mm counts, without uncertainty (and let u_z_mm of the rows "
            "hold it), or put these rows into a dataset of their own",
        )


def _missing_target(dataset: Dataset, *, by_rows: bool) -> Iterator[Problem]:
    board = dataset.manifest.board
    by_pairs = any(stem for table in dataset.rows for stem in table.stereo)
    if board is not None and board.target_corner is None and (by_rows or by_pairs):
        yield Problem(
            where=f"{MANIFEST}, [board] target",
            what=f"is missing, and no corner of {board.columns} x {board.rows} is the centre",
            remedy="say which corner is gazed at: target = [column, row], counted from 0",
        )


def _too_few_images(dataset: Dataset) -> Iterator[Problem]:
    for name, images in dataset.images.items():
        if 0 < len(images) < MIN_VIEWS:
            yield Problem(
                where=f"{MANIFEST}, [cameras.{name}] images",
                what=f"{len(images)} images, and intrinsics need {MIN_VIEWS} views at least",
                remedy="add images; 20 with the board tilted and all over the image are good",
            )


def _too_few_rows(dataset: Dataset) -> Iterator[Problem]:
    gaze, uses = dataset.gaze, _Uses.of(dataset)
    if not (uses.rows or uses.intrinsic or uses.pairs or uses.sweep):
        yield Problem(
            where=MANIFEST,
            what="names neither gaze rows nor images: there is nothing to calibrate",
            remedy="add [gaze], or images of a camera",
        )
    if gaze is not None and len(gaze) < MIN_ROWS:
        yield Problem(
            where=gaze.file,
            what=f"has {len(gaze)} row{'s' * (len(gaze) > 1)}; the smallest model needs {MIN_ROWS}",
            remedy="add gazes at other depths and places",
        )


def _missing_groups(dataset: Dataset) -> Iterator[Problem]:
    """Yield sections that state an error common to a group of rows, of a table without groups."""
    manifest = dataset.manifest
    sections = {
        "[gaze]": (manifest.gaze, dataset.gaze),
        "[validation]": (manifest.validation, dataset.validation),
    }
    for name, (section, table) in sections.items():
        if section is None or table is None or table.groups != table.ids:
            continue
        for key in ("u_z_group_mm", "u_z_group_rel"):
            if getattr(section, key) > 0:
                yield Problem(
                    where=f"{MANIFEST}, {name} {key}",
                    what=f"is of rows of one group, and {table.file} names no groups",
                    remedy="add the column group, the same name for rows that share a reference",
                )


def _named(
    table: GazeTable | LengthTable, bad: BoolArray, column: str, what: str, remedy: str
) -> Iterator[Problem]:
    """Yield a problem for each of the first rows in which `bad` holds; `what` may say {value}."""
    values = list(getattr(table, {"from": "start", "to": "end"}.get(column, column)))
    rows = np.flatnonzero(bad)
    for i in rows[:NAMED_ROWS]:
        place = row_place(table.file, table.line[i], table.ids[i], column)
        yield Problem(where=place, what=what.format(value=_cell(values[i])), remedy=remedy)
    if len(rows) > NAMED_ROWS:
        place = f"{table.file}, column {column}"
        yield Problem(
            where=place, what=f"the same in {len(rows) - NAMED_ROWS} more rows", remedy=remedy
        )


def _cell(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else shown(value)


def _unknown_pairs(dataset: Dataset) -> Iterator[Problem]:
    """Yield rows whose stereo pair does not exist."""
    pairs = dataset.stereo_pairs
    for table in dataset.rows:
        bad = np.array([stem is not None and stem not in pairs for stem in table.stereo])
        if not bad.any():
            continue
        close = nearest(str(table.stereo[int(np.argmax(bad))]), pairs)
        if not pairs:
            remedy = "add [stereo] with the images of both cameras"
        elif close is None:
            remedy = "give the name of the pair's images without folder and ending"
        else:
            remedy = f"did you mean {shown(close)}?"
        yield from _named(table, bad, "stereo", "there is no stereo pair {value}", remedy)


def _unknown_ends(dataset: Dataset) -> Iterator[Problem]:
    """Yield lengths whose ends are not rows, or rows of both tables."""
    lengths, manifest = dataset.lengths, dataset.manifest
    unread = (dataset.gaze is None and manifest.gaze is not None) or (
        dataset.validation is None and manifest.validation is not None
    )
    if lengths is None or unread:
        return
    ids = [set(table.ids) for table in dataset.rows]
    everywhere = set.union(*ids) if ids else set()
    twice = set.intersection(*ids) if len(ids) > 1 else set()
    for column, names in (("from", lengths.start), ("to", lengths.end)):
        unknown = np.array([name not in everywhere for name in names])
        remedy = "name a row of the gaze or validation table"
        yield from _named(lengths, unknown, column, "there is no row {value}", remedy)
        double = np.array([name in twice for name in names])
        what = "{value} is a gaze row as well as a validation row"
        yield from _named(lengths, double, column, what, "rename one of them")


def _pixels_outside(dataset: Dataset) -> Iterator[Problem]:
    """Yield pixels that are not in the image."""
    sizes = {}
    for name in CAMERAS:
        section = dataset.manifest.camera(name)
        if name in dataset.cameras:
            sizes[name] = dataset.cameras[name].image_size
        elif section is not None and section.image_size is not None:
            sizes[name] = section.image_size
    for column, camera, axis in (("u1_px", "c1", 0), ("v1_px", "c1", 1), ("u2_px", "c2", 0)):
        if camera not in sizes:
            continue
        extent = sizes[camera][axis]
        for table in dataset.rows:
            values: FloatArray = getattr(table, column)
            # The first pixel's centre is 0, so the image begins half a pixel before.
            bad = (values < -0.5) | (values > extent - 0.5)
            what = f"{{value}} is outside the image of {camera}, 0 to {extent - 1}"
            yield from _named(table, bad, column, what, "check image_size and the columns' order")


def _pixels_without_ray(dataset: Dataset) -> Iterator[Problem]:
    """Yield pixels of given cameras in the picture that no ray of the lens reaches."""
    remedy = "check the pixel, and the distortion of the camera, which folds back before it"
    for table in dataset.rows:
        for name, column in (("c1", "u1_px"), ("c2", "u2_px")):
            camera = dataset.cameras.get(name)
            if camera is None:
                continue
            pixels = on_centre_row(camera, table.u2_px)
            if name == "c1":
                pixels = np.column_stack([table.u1_px, table.v1_px])
            size = np.array(camera.image_size)
            with np.errstate(invalid="ignore"):
                inside = ((pixels > -0.5) & (pixels < size - 0.5)).all(axis=1)
            bad = inside & without_ray(camera, pixels)
            what = f"{{value}}: the lens of {name} has no ray there"
            yield from _named(table, bad, column, what, remedy)
