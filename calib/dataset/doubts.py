"""What is no fault of a dataset but may be a slip: a line each, and the run goes on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.core.arrays import FloatArray
from calib.dataset.contents import Dataset
from calib.dataset.conventions import better_convention, misfit
from calib.dataset.encoder import FURTHER
from calib.dataset.given_lens import assumed_of_lens
from calib.dataset.lens_slips import lens_doubts
from calib.dataset.manifest import GazeSection, ValidationSection
from calib.dataset.tables import GazeTable
from calib.geometry.camera import normalise

CENTRE_SHARE = 0.2
"""Part of the image size by which a principal point may lie off the centre without remark; lenses
are mounted within a few per cent, so more means a matrix of images of another size."""

LARGEST_U_Z_REL = 0.05
"""Relative standard uncertainty of a reference depth from which per cent may be meant."""

SMALL_DEPTHS_MM = 200.0
"""Depths of a whole table below this may be centimetres or inches: few lenses focus there."""

SMALL_BASELINE_MM = 20.0
"""Two cameras side by side are seldom nearer: a smaller one may come of depths in centimetres."""

UNITS = ((10.0, "centimetres"), (25.4, "inches"), (1000.0, "metres"), (0.1, "tenths of a mm"))
UNIT_TOLERANCE = 0.15
"""Of the ratio of two baselines: the rows' is no better where the axis stands off."""

COARSE_RATIO = 3.0
"""Step of the readings over the stated resolution that is more than how numbers happen to fall."""

GRID_ROWS = 6
"""Readings whose common step tells: that six are multiples of 4 steps by chance is 1 in 4,000."""

GRID_DECIMALS = 6

DEPTH_SPREAD = 0.01
"""Relative spread of depths below which targets stand at one depth."""


NAMED_ROWS = 5
"""Rows that are named at most."""


def doubts(dataset: Dataset) -> Iterator[str]:
    """Yield what is no fault but may be a slip, a line each."""
    for name, camera in dataset.cameras.items():
        centre = camera.matrix[:2, 2]
        off = np.abs(centre - (np.array(camera.image_size) - 1) / 2) / camera.image_size
        if off.max() > CENTRE_SHARE:
            yield (
                f"[cameras.{name}]: the principal point ({centre[0]:g}, {centre[1]:g}) is far from "
                f"the centre of a {camera.image_size[0]} x {camera.image_size[1]} image: do "
                "matrix and image_size belong to images of one size?"
            )
        assumed = assumed_of_lens(dataset, name)
        if assumed is not None:
            yield assumed
        yield from (f"[cameras.{name}]: {doubt}" for doubt in lens_doubts(camera.distortion))
    yield from _per_cent(dataset)
    yield from _reading(dataset)
    yield from _own_pictures(dataset)
    if dataset.gaze is not None:
        yield from _gaze_doubts(dataset, dataset.gaze)
        yield from _step_doubts(dataset, dataset.gaze)
    for table in dataset.rows:
        yield from _convention_doubts(dataset, table)


def _own_pictures(dataset: Dataset) -> Iterator[str]:
    """Yield rows whose picture by C2 is that of the pair which gave their depth."""
    content = dataset.image_sha256
    for table in dataset.rows:
        same = []
        for i, (image, stem) in enumerate(zip(table.image_c2, table.stereo, strict=True)):
            pair = dataset.stereo_pairs.get(stem or "")
            if image is None or pair is None:
                continue
            if image == pair[1] or content.get(image, image) == content.get(pair[1], pair[1]):
                same.append(table.ids[i])
        if same:
            named = ", ".join(same[:NAMED_ROWS]) + (", ..." if len(same) > NAMED_ROWS else "")
            yield (
                f"{table.file}: reading and reference depth of {len(same)} of {len(table)} rows "
                f"come from one picture by C2, that of the pair ({named}): what is wrong with it "
                "is wrong in both and cannot show; take a picture by C2 of its own for each row, "
                "turned to the target"
            )


def _reading(dataset: Dataset) -> Iterator[str]:
    """Yield what is assumed of a reading whose uncertainty is not stated."""
    encoder = dataset.manifest.encoder
    if encoder is None or encoder.u_alpha2_deg is not None or encoder.reads not in FURTHER:
        return
    yield (
        f'[encoder]: u_alpha2_deg is not stated; with reads = "{encoder.reads}" '
        f"{encoder.further_u_deg:.2g} deg are assumed for {FURTHER[encoder.reads]}; "
        "`calib rig check` measures it"
    )


def _per_cent(dataset: Dataset) -> Iterator[str]:
    """Yield relative uncertainties that look like per cent."""
    sections = {"gaze": dataset.manifest.gaze, "validation": dataset.manifest.validation}
    for name, section in sections.items():
        for key in ("u_z_rel", "u_z_group_rel"):
            value = 0.0 if section is None else getattr(section, key)
            if value >= LARGEST_U_Z_REL:
                yield (
                    f"[{name}] {key} = {value:g} is {100 * value:g} % of each depth: if "
                    f"{value:g} % is meant, write {value / 100:g}"
                )


def _step_doubts(dataset: Dataset, gaze: GazeTable) -> Iterator[str]:
    """Yield a resolution that the readings contradict: in radians, or finer than they are."""
    encoder = dataset.manifest.encoder
    step = grid_step(np.rad2deg(gaze.alpha2_rad))
    if encoder is None or step is None or step < COARSE_RATIO * encoder.resolution_deg:
        return
    stated = f"[encoder] resolution_deg = {encoder.resolution_deg:g}"
    if abs(np.rad2deg(encoder.resolution_deg) / step - 1) < UNIT_TOLERANCE:
        yield (
            f"{stated}, and all readings are multiples of {step:g} degrees: if the resolution is "
            f"in radians, write {step:g}"
        )
        return
    yield (
        f"{stated}, and all readings are multiples of {step:g} degrees: if they are rounded, the "
        "depths are less certain than stated; write down all digits, or state the step"
    )


def grid_step(readings_deg: FloatArray) -> float | None:
    """Return the largest step of which all readings are multiples, deg; None if none tells.

    Parameters
    ----------
    readings_deg
        Shape (n,).
    """
    known = np.unique(readings_deg[np.isfinite(readings_deg)])
    units = np.round(known * 10**GRID_DECIMALS).astype(np.int64)
    if len(units) < GRID_ROWS or np.abs(units * 10.0**-GRID_DECIMALS - known).max() > 1e-9:
        return None
    return float(np.gcd.reduce(units)) * 10.0**-GRID_DECIMALS


def _convention_doubts(dataset: Dataset, table: GazeTable) -> Iterator[str]:
    """Yield readings or depths that another convention or unit explains far better."""
    is_left = dataset.manifest.rig.is_left
    x1c, reading = _coordinates(dataset, table), np.rad2deg(table.alpha2_rad)
    meant = better_convention(reading, x1c, table.z_mm, is_left=is_left)
    if meant is not None:
        yield f"{table.file}, alpha2_deg: {meant[0]}? Then {meant[1]}"
        return
    found, known = misfit(x1c, reading, table.z_mm), table.z_mm[table.z_mm > 0]
    baseline = None if found is None else abs(found.baseline_mm)
    small = baseline is not None and baseline < SMALL_BASELINE_MM
    stated = _stated_baseline(dataset)
    asks = (
        "" if baseline is None else f", and the rows then ask for a baseline of {baseline:.3g} mm"
    )
    extent = "" if not len(known) else f"depths of {known.min():.4g} to {known.max():.4g}"
    if baseline and stated is not None:
        for factor, unit in UNITS:
            if abs(stated / baseline / factor - 1) < UNIT_TOLERANCE:
                yield (
                    f"{table.file}, z_mm: {extent}{asks} where {stated:.3g} mm is stated: "
                    f"{unit}? Give them in millimetres"
                )
    elif len(known) and (small or known.max() < SMALL_DEPTHS_MM):
        yield f"{table.file}, z_mm: {extent}{asks}: centimetres or inches? Give them in millimetres"


def _coordinates(dataset: Dataset, table: GazeTable) -> FloatArray:
    """Return x1c of a table's rows, NaN where only pictures or unknown lenses give it."""
    camera = dataset.cameras.get("c1")
    if camera is None:
        return table.x1c
    pixels = np.column_stack([table.u1_px, table.v1_px])
    known = np.isfinite(pixels).all(axis=1)
    x1c = np.array(table.x1c)
    if known.any():
        x1c[known] = normalise(camera, pixels[known], strict=False)[:, 0]
    return x1c


def _stated_baseline(dataset: Dataset) -> float | None:
    """Return the baseline that the manifest states, mm."""
    stereo, prior = dataset.manifest.stereo, dataset.manifest.priors.get("baseline_mm")
    if prior is not None:
        return abs(prior.mean)
    if stereo is not None and stereo.transform is not None:
        return abs(stereo.transform[0][3])
    return None


def _gaze_doubts(dataset: Dataset, gaze: GazeTable) -> Iterator[str]:
    stated = dataset.manifest.gaze
    by_image = all(image is not None for image in gaze.image_c1)
    if stated is not None and "u_x1c" not in stated.model_fields_set and not by_image:
        yield f"[gaze] states no u_x1c: {stated.u_x1c:g} is assumed (0.1 px at f = 500 px)"
    known = gaze.z_mm[~np.isnan(gaze.z_mm)]
    if len(known) and stated is not None and stated.origin is None:
        yield (
            "[gaze] does not say from where z_mm counts: that is found from the rows, and depths "
            "from C1's optical centre are less certain for it. Measure it and state z_from, for "
            "example { ahead_of_c1_mm = 35.0, u_mm = 2.0 } for the front of a lens, or "
            'z_from = "c1" for depths that a camera calibration gave'
        )
    silent = ~np.isnan(gaze.z_mm) & np.isnan(gaze.u_z_mm)
    if stated is not None and silent.any() and not any(_stated_depth(stated)):
        yield (
            f"{gaze.file} and [gaze] state no uncertainty of z_mm: the reference depths of "
            f"{silent.sum()} rows are taken as exact"
        )
    if len(known) == len(gaze) and np.ptp(known) < DEPTH_SPREAD * known.min():
        yield (
            f"{gaze.file}: all targets stand at nearly the same depth, {known.min():g} to "
            f"{known.max():g} mm: baseline and zero error can hardly be distinguished; add targets "
            "nearer and farther"
        )


def _stated_depth(section: GazeSection | ValidationSection) -> tuple[float, ...]:
    """Return all that a section states of the uncertainty of z."""
    return section.u_z_mm, section.u_z_rel, section.u_z_group_mm, section.u_z_group_rel
