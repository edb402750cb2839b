"""What jobs have at hand: the open rig, its calibration, the hand that puts targets up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from calib.capture.rows import targets_before
from calib.capture.writer import GrowingFolder
from calib.core.arrays import FloatArray
from calib.gaze.aim import EpipolarAiming
from calib.gaze.gazing import Gazer, law_of
from calib.gaze.measured import aiming, lenses
from calib.gaze.placing import Placing, placing_for
from calib.gaze.target import Target, target
from calib.geometry.board import Board
from calib.geometry.camera import Camera
from calib.geometry.parameters import vector
from calib.instrument.calibration_file import Measuring, read_calibration
from calib.live.guarded import GuardedAxis
from calib.live.hand import PageHand
from calib.live.record import Record
from calib.live.scene import rig_scene
from calib.rig.check_file import check_path, fit_check
from calib.rig.devices import RigDevices
from calib.rig.known import Role, known_board, known_lens

PLATE: Final = "plate:1400,500,10"
"""What the virtual rig puts up where a plate's corner is asked for and rig.toml names no plate."""

BOARD: Final = "board"
PLATE_TARGET: Final = "plate:"

UNKNOWN_DEPTHS: Final = (500.0, 2000.0)
"""Drawn before a calibration says which depths it covers, mm."""


@dataclass(frozen=True)
class Places:
    """Where things lie.

    Parameters
    ----------
    rig_file
        rig.toml; None for the embedded virtual rig.
    dataset, run
        Folder of captured rows, and of the calibration made of them.
    """

    rig_file: Path | None
    dataset: Path
    run: Path


@dataclass(frozen=True)
class RigCalibration:
    """A calibration of this rig, with its file.

    Parameters
    ----------
    accepted
        Whether the user takes it although its gates failed.
    """

    path: Path
    measuring: Measuring
    c1: Camera
    c2: Camera
    accepted: bool = False

    @property
    def aiming(self) -> EpipolarAiming:
        """Where to look for targets."""
        return aiming(self.measuring, self.c1)

    @property
    def gate_failed(self) -> bool:
        """Whether what is measured with it is not simply right."""
        return bool(self.measuring.failed_gates) and not self.accepted


def read_calibrated(
    path: Path, rig: RigDevices, *, allow_edited: bool = False, accepted: bool = False
) -> RigCalibration:
    """Return the calibration in a file.

    Parameters
    ----------
    allow_edited, accepted
        Whether the user takes one that was edited, or whose gates failed.

    Raises
    ------
    InputError
        If it is none of this rig.
    """
    measuring = read_calibration(path, allow_edited=allow_edited)
    known = lenses(measuring, rig, name=str(path))
    return RigCalibration(path, measuring, known.c1, known.c2, accepted)


@dataclass
class Bench:
    """The open rig.

    Parameters
    ----------
    rig
        Its devices; the axis is `axis`.
    axis
        Guarded by Stop.
    places
        Where things lie.
    record
        What the pages show.
    calib
        How the program is called, for the chain, which runs as a process of its own.
    board
        The rig's.
    calibrated
        The calibration in use.
    csv, lengths_csv
        Lines of the tables of measurements, without the first.
    last_mm
        Depth last measured, mm.
    """

    rig: RigDevices
    axis: GuardedAxis
    places: Places
    record: Record
    calib: Sequence[str]
    board: Board | None = None
    calibrated: RigCalibration | None = None
    csv: list[str] = field(default_factory=list)
    lengths_csv: list[str] = field(default_factory=list)
    last_mm: float | None = None
    _hand: tuple[str, Placing] | None = None
    _up: str = ""

    def __post_init__(self) -> None:
        self.board = known_board(self.rig)
        self._up = self.rig.settings.virtual.target

    def target(self, name: str) -> Target:
        """Return the target of a name.

        Raises
        ------
        UsageError
            If it is none.
        """
        return target(name, self.board)

    def hand(self, name: str) -> Placing:
        """Return the hand that puts up a target; a virtual rig's takes up what is asked for."""
        world = self.rig.world
        if world is None:
            return PageHand(self.record, self.axis.refuse_stopped)
        wanted = self._wanted(name)
        if wanted != self._up:
            world.take_up(wanted)
            self._up = wanted
        if self._hand is None or self._hand[0] != wanted:
            # Targets come in a row: those to measure are not those that were captured.
            before = targets_before(GrowingFolder(self.places.dataset))
            made = placing_for(self.rig, lambda _: None, before=before)
            self._hand = (wanted, made)
        return self._hand[1]

    def _wanted(self, name: str) -> str:
        """Return what of a virtual rig's has to stand there for a target."""
        own = self.rig.settings.virtual.target
        if name.startswith(PLATE_TARGET):
            return own if own.startswith(PLATE_TARGET) else PLATE
        return BOARD if name.startswith((BOARD, "corner:")) else own

    def gazer(self, at: Target, lens_c2: Camera, lens_c1: Camera | None = None) -> Gazer:
        """Return the rig ready to gaze at a target, as its last check found it."""
        check = fit_check(check_path(self.places.rig_file), serial=self.rig.serial)
        return Gazer(
            rig=self.rig,
            target=at,
            lens_c1=lens_c1,
            lens_c2=lens_c2,
            law=law_of(
                self.rig, lens_c2, backlash_steps=0.0 if check is None else check.backlash_steps
            ),
            settle_s=0.0 if check is None else check.settle_s,
        )

    def use(self, path: Path, *, allow_edited: bool = False, accepted: bool = False) -> None:
        """Take a calibration into use; see `read_calibrated` for parameters and errors."""
        self.calibrated = read_calibrated(
            path, self.rig, allow_edited=allow_edited, accepted=accepted
        )
        measuring = self.calibrated.measuring
        self.record.put(
            calibration={
                "path": str(path),
                "depths_mm": list(measuring.calibrated_mm),
                "failed_gates": [f"{g.name}: {g.detail}" for g in measuring.failed_gates],
            }
        )
        self.draw()

    def draw(self) -> None:
        """Publish the rig as it is drawn from above, as far as it is known."""
        theta, c1, c2, depths = self._known()
        if theta is not None and c1 is not None and c2 is not None:
            self.record.put(scene=rig_scene(theta, c1, c2, depths))

    def lens(self, role: Role) -> Camera | None:
        """Return a camera's lens as far as it is known."""
        _, c1, c2, _ = self._known()
        return c1 if role == "c1" else c2

    def centre_column(self) -> float | None:
        """Return C2's centre column in its middle row, px; None while its lens is unknown."""
        lens = self.lens("c2")
        return None if lens is None else float(lens.matrix[0, 2])

    def theta(self) -> FloatArray | None:
        """Return the parameters by calibration or tape measure; None if there are neither."""
        return self._known()[0]

    def _known(
        self,
    ) -> tuple[FloatArray | None, Camera | None, Camera | None, tuple[float, float]]:
        if self.calibrated is not None:
            measuring = self.calibrated.measuring
            c1, c2 = self.calibrated.c1, self.calibrated.c2
            return measuring.instrument.theta, c1, c2, measuring.calibrated_mm
        baseline = self.rig.settings.nominal_baseline_mm
        theta = None if baseline is None else vector({"baseline_mm": baseline})
        return theta, known_lens(self.rig, "c1"), known_lens(self.rig, "c2"), UNKNOWN_DEPTHS


def with_axis(rig: RigDevices, axis: GuardedAxis) -> RigDevices:
    """Return the devices with a guarded axis."""
    return replace(rig, axis=axis)
