"""A session with images: boards in front of the rig, and what is seen of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calib.core.arrays import FloatArray
from calib.dataset.board_section import section_of
from calib.geometry.board import Board
from calib.simulate.contents import (
    U_LENGTH_MM,
    CsvTable,
    RenderedShot,
    Section,
    SimulatedSession,
    SimulationOptions,
    degree,
    degrees,
    ids,
)
from calib.simulate.rig import Noise, TrueRig, c2_pose, yaw_axis_in_c2
from calib.simulate.scene import (
    Placement,
    draw_gaze_poses,
    draw_intrinsic_views,
    draw_sweep,
    held_reading,
    invert,
    target_in_c1,
)
from calib.simulate.tables import SimulatedRows, observe

VALIDATION_REACH = 1.2
"""Validation rows go so far beyond the largest calibrated depth."""


def draw_image_session(
    options: SimulationOptions, rig: TrueRig, board: Board, rng: np.random.Generator
) -> SimulatedSession:
    """Draw where the boards stand, what C2 reads and every image of a session.

    C1 and C2 each see the board for their intrinsics. Each calibration row is one board at rest:
    a stereo pair with C2 held at one yaw gives its depth, then C2 gazes at it. Each validation row
    is a board whose depth a ruler gives. Last, C2 sweeps before boards at rest.

    Raises
    ------
    UsageError
        If some image cannot show the whole board.
    """
    rig = _seen_by_images(rig)
    # One stream for each part: another number of rows leaves the views as they were.
    gazes, checks, views, sweeps = rng.spawn(4)
    near, far = options.depth_range_mm or rig.depth_range_mm
    held = held_reading(rig, (near, far))
    stands = float(_standing(rig, gazes, np.array([held]))[0])
    poses, gaze = _gazed(
        rig, board, gazes, count=options.rows, depth_range_mm=(near, far), held=stands
    )
    further = (near, VALIDATION_REACH * far)
    check_poses, validation = _gazed(
        rig, board, checks, count=options.validation_rows, depth_range_mm=further, held=None
    )
    placements = draw_sweep(rig, board, sweeps, options.sweep)
    swept = [_standing(rig, sweeps, p.readings) for p in placements]
    shots = (
        *_intrinsic_shots(options, rig, board, views),
        *_row_shots("stereo", "g", poses, c2_pose(rig, np.full(len(poses), stands))),
        *_row_shots("gaze", "g", poses, c2_pose(rig, gaze.true_gaze.alpha2)),
        *_row_shots("validation", "v", check_poses, c2_pose(rig, validation.true_gaze.alpha2)),
        *_sweep_shots(rig, placements, swept),
    )
    return SimulatedSession(
        rig=rig,
        board=board,
        gaze=gaze,
        validation=validation,
        manifest=_sections(rig, board, held=held, swept=bool(placements)),
        tables=_tables(gaze, validation, placements),
        truth=_truth(rig, shots, stands=stands, swept=swept),
        shots=shots,
    )


def _gazed(
    rig: TrueRig,
    board: Board,
    rng: np.random.Generator,
    *,
    count: int,
    depth_range_mm: tuple[float, float],
    held: float | None,
) -> tuple[FloatArray, SimulatedRows]:
    """Return boards, C1 from board, shape (count, 4, 4), and the gazes at them."""
    poses = draw_gaze_poses(rig, board, rng, count=count, depth_range_mm=depth_range_mm, held=held)
    return poses, observe(rig, rng, target_in_c1(board, poses))


def _seen_by_images(rig: TrueRig) -> TrueRig:
    """Return the rig with the errors left out that rendered images bring along by themselves."""
    noise = Noise(pixel_px=0.0, encoder_rad=rig.noise.encoder_rad, z_mm=U_LENGTH_MM, z_rel=0.0)
    return replace(rig, noise=noise)


def _standing(rig: TrueRig, rng: np.random.Generator, readings: FloatArray) -> FloatArray:
    """Return where C2 truly stands, as a reading, rad, at each count."""
    return readings + rig.noise.encoder_rad * rng.standard_normal(len(readings))


def _intrinsic_shots(
    options: SimulationOptions, rig: TrueRig, board: Board, rng: np.random.Generator
) -> Iterator[RenderedShot]:
    for name, camera in (("c1", rig.c1), ("c2", rig.c2)):
        poses = draw_intrinsic_views(camera, board, rng, options.views)
        for i, pose in enumerate(poses):
            yield RenderedShot(f"intrinsics/{name}/{i:02d}.png", name, pose)


def _row_shots(
    folder: str, letter: str, poses: FloatArray, standing: FloatArray
) -> Iterator[RenderedShot]:
    """Return both cameras' images of boards.

    Parameters
    ----------
    poses
        C1 from board, shape (n, 4, 4).
    standing
        1T2 while the images were taken, shape (n, 4, 4).
    """
    names = ids(letter, len(poses))
    seen = invert(standing) @ poses
    for name, in_c1, in_c2 in zip(names, poses, seen, strict=True):
        yield RenderedShot(f"{folder}/c1/{name}.png", "c1", in_c1)
        yield RenderedShot(f"{folder}/c2/{name}.png", "c2", in_c2)


def _sweep_shots(
    rig: TrueRig, placements: tuple[Placement, ...], swept: list[FloatArray]
) -> Iterator[RenderedShot]:
    for k, (placement, stands) in enumerate(zip(placements, swept, strict=True)):
        for i, pose in enumerate(invert(c2_pose(rig, stands)) @ placement.pose):
            yield RenderedShot(f"sweep/{k}-{i:02d}.png", "c2", pose)


def _tables(
    gaze: SimulatedRows, validation: SimulatedRows, placements: tuple[Placement, ...]
) -> dict[str, CsvTable]:
    pairs, ruler = ids("g", len(gaze.points_mm)), validation.observed
    tables = {
        "gaze.csv": CsvTable.of(_image_columns("gaze", gaze) | {"stereo": pairs}),
        "validation.csv": CsvTable.of(
            _image_columns("validation", validation)
            | {"z_mm": ruler.z_mm.tolist(), "u_z_mm": ruler.std[:, -1].tolist()}
        ),
    }
    if placements:
        tables["sweep.csv"] = _sweep_table(placements)
    return tables


def _image_columns(folder: str, rows: SimulatedRows) -> dict[str, Sequence[str | float]]:
    """Return the columns of rows that images give."""
    names = ids(folder[0], len(rows.points_mm))
    return {
        "id": names,
        "image_c1": [f"{folder}/c1/{name}.png" for name in names],
        "alpha2_deg": degrees(rows.observed.alpha2_rad),
        "image_c2": [f"{folder}/c2/{name}.png" for name in names],
    }


def _sweep_table(placements: tuple[Placement, ...]) -> CsvTable:
    rows = tuple(
        (f"s{k}-{i:02d}", f"p{k}", f"sweep/{k}-{i:02d}.png", reading)
        for k, placement in enumerate(placements)
        for i, reading in enumerate(degrees(placement.readings))
    )
    return CsvTable(("id", "placement", "image_c2", "alpha2_deg"), rows)


def _sections(rig: TrueRig, board: Board, *, held: float, swept: bool) -> Section:
    """Return the sections of the manifest that images need."""
    sections: Section = {
        "board": section_of(board),
        "cameras": {
            name: {"image_size": list(camera.image_size), "images": f"intrinsics/{name}/*.png"}
            for name, camera in (("c1", rig.c1), ("c2", rig.c2))
        },
        "stereo": {
            "c1": "stereo/c1/*.png",
            "c2": "stereo/c2/*.png",
            "alpha2_deg": degree(held),
        },
        "gaze": {"table": "gaze.csv", "reference": "stereo pairs, C2 held"},
        "validation": {"table": "validation.csv", "reference": "ruler, simulated"},
    }
    if swept:
        sections["sweep"] = {"table": "sweep.csv"}
    return sections


def _truth(
    rig: TrueRig, shots: tuple[RenderedShot, ...], *, stands: float, swept: list[FloatArray]
) -> dict[str, Any]:
    axis = yaw_axis_in_c2(rig)
    return {
        "stereo": {
            "alpha2_rad": stands,
            "transform_12": c2_pose(rig, np.array(stands)).tolist(),
        },
        "yaw_axis_c2": {
            "direction": axis.direction.tolist(),
            "foot_mm": axis.foot_mm.tolist(),
        },
        "sweep": {"alpha2_rad": [readings.tolist() for readings in swept]},
        "images": {s.path: {"camera": s.camera, "pose": s.pose.tolist()} for s in shots},
    }
