"""Sessions of simulated rigs as corners, without rendering: what the adjustment is given."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.board import Board, Corners
from calib.geometry.camera import intrinsic_vector, with_intrinsics
from calib.geometry.parameters import PARAMETERS, EncoderTerm
from calib.images.adjustment.gather import Rows, Swept, Taken
from calib.images.bundle import deformed
from calib.images.stereo.solve import CameraPair
from calib.simulate.contents import CsvTable, SimulationOptions
from calib.simulate.rig import TrueRig, draw_rig, draw_wide_camera, mirror_rig
from calib.simulate.scene import IntrinsicViews, SweepPlan, fitting_board
from calib.simulate.session import draw_image_session
from tests.images import board_scenes as scenes

LENS_STD = np.array([2.0, 2.0, 2.0, 2.0, 0.01, 0.02, 1e-3, 1e-3, 0.01])
"""How far off the lens stage may leave the intrinsics."""

WIDE_STD = np.array([2.0, 2.0, 2.0, 2.0, 1e-3, 1e-3, 1e-3, 1e-3])
"""The same of an equidistant lens."""


@dataclass(frozen=True)
class Layout:
    """What a session has."""

    rows: int = 8
    lens: int = 6
    placements: int = 2
    swept: int = 8
    pairs: bool = True
    free: tuple[bool, bool] = (True, True)
    is_left: bool = False
    u_given: float = 0.0
    c1_field_deg: float | None = None


@dataclass(frozen=True)
class Pictured:
    """Exact corners of a session, what is known of it, and how far the boards stand, mm."""

    rig: TrueRig
    board: Board
    taken: Taken
    exact: dict[str, FloatArray] = field(repr=False)
    cameras: dict[str, str] = field(repr=False)
    distance_mm: dict[str, float] = field(repr=False)

    def corners(self, rng: np.random.Generator, sigma_px: float) -> tuple[Corners, Corners]:
        found = []
        for name, camera in (("c1", self.rig.c1), ("c2", self.rig.c2)):
            own = tuple(path for path, whose in self.cameras.items() if whose == name)
            pixels = np.array([self.exact[path] for path in own])
            pixels = pixels + sigma_px * rng.standard_normal(pixels.shape)
            found.append(Corners(own, pixels, ("cache",) * len(own), camera.image_size))
        return found[0], found[1]

    def pair(
        self, rng: np.random.Generator, free: tuple[bool, bool], *, u_given: float = 0.0
    ) -> CameraPair:
        """Cameras to start from: a little off where they are free; given ones by `u_given`."""
        cameras, covariances = [], []
        for camera, is_free in zip((self.rig.c1, self.rig.c2), free, strict=True):
            size = u_given * camera.matrix[0, 0]
            usual = LENS_STD if camera.projection == "perspective" else WIDE_STD
            count = len(usual)
            std = usual if is_free else np.r_[size * np.ones(4), np.zeros(count - 4)]
            by_focal = np.zeros((count, count))
            by_focal[:2, :2] = size**2
            known = np.diag([0, 0, *std[2:] ** 2]) + by_focal
            own = np.zeros((count, count)) if is_free else known
            error = std * rng.standard_normal(count)
            if not is_free:
                error[1] = error[0]
            drawn = intrinsic_vector(camera) + error
            cameras.append(with_intrinsics(camera, drawn))
            covariances.append(own)
        return CameraPair(
            (cameras[0], cameras[1]), (covariances[0], covariances[1]), self.rig.is_left, free
        )


def everything(
    rng: np.random.Generator, *, is_left: bool = False, c1_field_deg: float | None = None
) -> TrueRig:
    """A rig with all errors that the model has, the encoder's drawn from their priors."""
    encoder = {
        p.name: float(rng.normal(0, p.prior_std))
        for p in PARAMETERS
        if isinstance(p.effect, EncoderTerm) and p.prior_std
    }
    rig = draw_rig(rng, model="axis-tilt", fixed=encoder)
    if c1_field_deg is not None:
        c1 = draw_wide_camera(rng, field_deg=c1_field_deg, image_size=rig.c1.image_size)
        rig = replace(rig, c1=c1)
    return mirror_rig(rig) if is_left else rig


def session(
    rng: np.random.Generator, rig: TrueRig, layout: Layout = Layout(), *, bow_mm=(0.3, -0.2)
) -> Pictured:
    """Draw where boards stand, and their exact corners on a board that is bowed."""
    options = SimulationOptions(
        seed=0,
        images=True,
        rows=layout.rows,
        validation_rows=0,
        views=IntrinsicViews(count=layout.lens),
        sweep=SweepPlan(placements=layout.placements, images=layout.swept),
    )
    board = fitting_board(rig, near_mm=rig.depth_range_mm[0])
    drawn = draw_image_session(options, rig, board, rng)
    points = deformed(board.object_points(), bow_mm)
    whose = {"c1": rig.c1, "c2": rig.c2}
    shots = [s for s in drawn.shots if layout.pairs or not s.path.startswith("stereo/")]
    placed = {s.path: points @ s.pose[:3, :3].T + s.pose[:3, 3] for s in shots}
    exact = {s.path: scenes.project(whose[s.camera], placed[s.path]) for s in shots}
    distance = {path: float(np.linalg.norm(p.mean(axis=0))) for path, p in placed.items()}
    gaze = _columns(drawn.tables["gaze.csv"])
    rows = Rows(
        tuple(gaze["id"]),
        tuple(gaze["image_c1"]),
        tuple(gaze["image_c2"]),
        np.deg2rad(np.array(gaze["alpha2_deg"], dtype=float)),
    )
    swept = Swept()
    if layout.placements:
        sweep = _columns(drawn.tables["sweep.csv"])
        readings = np.deg2rad(np.array(sweep["alpha2_deg"], dtype=float))
        swept = Swept(tuple(sweep["image_c2"]), tuple(sweep["placement"]), readings)
    lens = tuple(
        tuple(path for path in exact if path.startswith(f"intrinsics/{name}/"))
        for name in ("c1", "c2")
    )
    std = float(np.hypot(rig.resolution_rad / np.sqrt(12), rig.noise.encoder_rad))
    pairs = tuple((f"stereo/c1/{n}.png", f"stereo/c2/{n}.png") for n in gaze["id"])
    held = drawn.manifest["stereo"]["alpha2_deg"]
    taken = Taken(
        lens=(lens[0], lens[1]),
        pairs=pairs if layout.pairs else (),
        held_rad=float(np.deg2rad(held)) if layout.pairs else None,
        rows=rows,
        sweep=swept,
        reading_std_rad=std,
    )
    cameras = {shot.path: shot.camera for shot in drawn.shots if shot.path in exact}
    return Pictured(rig, board, taken, exact, cameras, distance)


def _columns(table: CsvTable) -> dict[str, tuple[Any, ...]]:
    return dict(zip(table.columns, zip(*table.rows, strict=True), strict=True))
