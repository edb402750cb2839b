"""What a simulated dataset holds, and the parts that all of them share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from calib.core.arrays import FloatArray
from calib.dataset.lens_section import camera_section
from calib.geometry.board import Board
from calib.geometry.parameters import NAMES
from calib.simulate.faults import FULL_STEP_COUNTS, size_of
from calib.simulate.rig import Noise, TrueRig, c2_pose
from calib.simulate.scene import IntrinsicViews, SweepPlan
from calib.simulate.tables import SimulatedRows

LENGTHS = 5
"""Known distances between validation targets; each joins two neighbours in the list."""

U_LENGTH_MM = 0.2
"""Standard uncertainty of the known distances and of the ruler that gives validation depths."""

_NOTHING: Mapping[str, float] = MappingProxyType({})

Row = tuple[str | float, ...]
Section = dict[str, Any]


@dataclass(frozen=True)
class SimulationOptions:
    """What to simulate.

    Parameters
    ----------
    seed
        Everything random follows from it.
    model
        Name in `calib.geometry.parameters.MODELS`.
    rows, validation_rows
        Gaze rows to calibrate with and to validate with; with images each row has a stereo pair.
    images
        Rendered board images instead of finished coordinates.
    fixed
        True parameters set to a value instead of drawn, by name.
    noise
        Instead of the rig's drawn noise. Images have the noise of `calib.simulate.render.Optics`
        instead of `pixel_px`, and no shared errors but those they bring about.
    depth_range_mm
        Depths of the gaze rows; None for the rig's own working depths.
    outlier_share
        Probability of a gaze row to carry a gross error (tables only).
    residual_measured
        Whether tables state the target's column in C2; images always show it.
    image_size
        Width and height of both cameras' images, px.
    board
        None for a 9 x 7 chessboard of a size that suits the depths.
    views
        Intrinsic images of each camera.
    sweep
        Yaw sweep.
    is_left
        Whether C2 stands at -X of C1; `fixed` is then of such a rig.
    c1_field_deg
        Full field of view along the diagonal of an equidistant lens of C1, with images; None for
        the drawn lens.
    faults
        Mistakes made with the rows, of `calib.simulate.faults`: size by name, None for the usual
        one (tables only).
    """

    seed: int
    model: str = "axis-offset"
    rows: int = 14
    validation_rows: int = 10
    images: bool = False
    fixed: Mapping[str, float] = field(default_factory=lambda: _NOTHING)
    noise: Noise | None = None
    depth_range_mm: tuple[float, float] | None = None
    outlier_share: float = 0.0
    residual_measured: bool = False
    image_size: tuple[int, int] = (1280, 960)
    board: Board | None = None
    views: IntrinsicViews = field(default_factory=IntrinsicViews)
    sweep: SweepPlan = field(default_factory=SweepPlan)
    is_left: bool = False
    c1_field_deg: float | None = None
    faults: Mapping[str, float | None] = field(default_factory=dict)


@dataclass(frozen=True)
class CsvTable:
    """A CSV table: its columns and rows."""

    columns: tuple[str, ...]
    rows: tuple[Row, ...]

    @classmethod
    def of(cls, columns: Mapping[str, Sequence[str | float]]) -> CsvTable:
        """Return the table with these columns, all of one length."""
        return cls(tuple(columns), tuple(zip(*columns.values(), strict=True)))


@dataclass(frozen=True)
class RenderedShot:
    """An image to render.

    Parameters
    ----------
    path
        Relative to the dataset.
    camera
        "c1" or "c2".
    pose
        Camera from board, shape (4, 4), mm.
    """

    path: str
    camera: str
    pose: FloatArray


@dataclass(frozen=True)
class Contents:
    """A dataset ready to be written.

    Parameters
    ----------
    rig, board
        What was simulated.
    manifest, tables, truth
        dataset.toml, the tables by file name, truth.json.
    shots
        The images, none for tables.
    """

    rig: TrueRig
    board: Board
    manifest: Section
    tables: Mapping[str, CsvTable]
    truth: Mapping[str, Any]
    shots: tuple[RenderedShot, ...]


@dataclass(frozen=True)
class SimulatedSession:
    """One simulated session: what is added to the shared parts of a dataset.

    Parameters
    ----------
    rig, board
        What was simulated.
    gaze, validation
        The rows.
    manifest, tables, truth
        Sections, tables by file name and entries of the truth that this kind of session has.
    shots
        Images.
    """

    rig: TrueRig
    board: Board
    gaze: SimulatedRows
    validation: SimulatedRows
    manifest: Section
    tables: Mapping[str, CsvTable]
    truth: Section = field(default_factory=dict)
    shots: tuple[RenderedShot, ...] = ()


def finish(
    options: SimulationOptions, session: SimulatedSession, rng: np.random.Generator
) -> Contents:
    """Return the whole dataset: the session with the head, the known lengths and the truth."""
    manifest = _head(options, session.rig) | session.manifest
    tables = dict(session.tables)
    if not len(session.validation.observed):
        del manifest["validation"], tables["validation.csv"]
    lengths = _lengths(session.validation, rng)
    if lengths.rows:
        manifest["lengths"] = {"table": "lengths.csv"}
        tables["lengths.csv"] = lengths
    truth = _truth(options, session) | session.truth
    return Contents(session.rig, session.board, manifest, tables, truth, session.shots)


def ids(letter: str, count: int) -> tuple[str, ...]:
    """Return names of rows, the letter and a number from 1."""
    return tuple(f"{letter}{i:02d}" for i in range(1, count + 1))


def degree(angle: float) -> float:
    """Return an angle, rad, in degrees to twelve digits: a count of the encoder reads clean."""
    return float(f"{np.degrees(angle):.12g}")


def degrees(angles: FloatArray) -> list[float]:
    """Return angles, rad, shape (n,), as `degree` does one."""
    return [degree(angle) for angle in angles.tolist()]


def _head(options: SimulationOptions, rig: TrueRig) -> Section:
    kind = "images" if options.images else "tables"
    return {
        "format": 1,
        "name": f"simulated-{options.model}-{options.seed}",
        "title": f"Simulated rig of model {options.model}, seed {options.seed}, {kind}",
        "source": {"notes": "Simulated by calib; truth.json holds what a lab would not know."},
        **({"rig": {"c2": "left"}} if rig.is_left else {}),
        "encoder": {
            "resolution_deg": degree(rig.resolution_rad),
            "u_alpha2_deg": degree(rig.noise.encoder_rad),
            **_full_step(options, rig),
        },
    }


def _full_step(options: SimulationOptions, rig: TrueRig) -> Section:
    """Return the motor's full step where its error is one of the mistakes."""
    if "microstep" not in options.faults:
        return {}
    return {"full_step_deg": degree(FULL_STEP_COUNTS * rig.resolution_rad)}


def _truth(options: SimulationOptions, session: SimulatedSession) -> Section:
    rig = session.rig
    return {
        "format": 1,
        "seed": options.seed,
        "model": rig.model,
        "parameters": dict(zip(NAMES, rig.theta.tolist(), strict=True)),
        "c2_mount": {
            "forward_mm": rig.forward_mm,
            "height_mm": rig.height_mm,
            "pitch_rad": rig.pitch_rad,
        },
        "cameras": {"c1": camera_section(rig.c1), "c2": camera_section(rig.c2)},
        "encoder": {"resolution_rad": rig.resolution_rad},
        "noise": asdict(rig.noise),
        **_faults(options),
        "rows": {
            "gaze": dict(_row_truth(rig, "g", session.gaze)),
            "validation": dict(_row_truth(rig, "v", session.validation)),
        },
    }


def _faults(options: SimulationOptions) -> Section:
    made = {name: size_of(name, value) for name, value in options.faults.items()}
    return {"faults": made} if made else {}


def _row_truth(rig: TrueRig, letter: str, rows: SimulatedRows) -> Iterator[tuple[str, Section]]:
    gaze = rows.true_gaze
    c2 = c2_pose(rig, gaze.alpha2)
    for i, name in enumerate(ids(letter, len(rows.points_mm))):
        yield (
            name,
            {
                "x1c": float(gaze.x1c[i]),
                "y1c": float(gaze.y1c[i]),
                "alpha2_rad": float(gaze.alpha2[i]),
                "gaze_residual_rad": float(gaze.residual[i]),
                "z_mm": float(rows.z_mm[i]),
                "point_mm": rows.points_mm[i].tolist(),
                "transform_12": c2[i].tolist(),
                "outlier": bool(rows.outliers[i]),
            },
        )


def _lengths(rows: SimulatedRows, rng: np.random.Generator) -> CsvTable:
    """Return distances between targets that follow each other, measured as a lab would."""
    points = rows.points_mm[: LENGTHS + 1]
    true = np.linalg.norm(np.diff(points, axis=0), axis=1)
    count = len(true)
    names = ids("v", count + 1)
    return CsvTable.of(
        {
            "id": ids("l", count),
            "from": names[:count],
            "to": names[1 : count + 1],
            "length_mm": (true + U_LENGTH_MM * rng.standard_normal(count)).tolist(),
            "u_length_mm": [U_LENGTH_MM] * count,
        }
    )
