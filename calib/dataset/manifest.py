"""dataset.toml, format 1: what a manifest may say.

The models are frozen and know nothing of files. Lengths are in mm; angles in the unit of their
name, degrees as encoders read; pixels have their origin at the centre of the top-left pixel.
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
from pydantic import Field, model_validator

from calib.dataset.corrections import AcceptedCause
from calib.dataset.depth_origin import DepthOrigin, origin_of
from calib.dataset.encoder import Encoder
from calib.dataset.fields import (
    AngleDeg,
    CameraMatrix,
    CornerCount,
    Country,
    Day,
    DepthTolerance,
    Flag,
    Line,
    NotNegative,
    Number,
    Percent,
    Pixels,
    Pose,
    Positive,
    Priors,
    Prose,
    Published,
    SquareMm,
    Target,
    UFocal,
    UX1c,
    UZRel,
    refuse,
    refuse_coefficients,
)
from calib.dataset.lens_slips import lens_fault
from calib.dataset.messages import shown, suggestion
from calib.dataset.section import Section
from calib.geometry.lens import ProjectionName

CAMERAS: Final = ("c1", "c2")

DEFAULT_U_X1C = 0.0002
"""A corner found to 0.1 px by a lens of 500 px; taken, with a warning, where nothing is stated."""

DICTIONARIES = (
    *(f"DICT_{n}X{n}_{count}" for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    "DICT_ARUCO_ORIGINAL",
    "DICT_ARUCO_MIP_36h12",
    *(f"DICT_APRILTAG_{kind}" for kind in ("16h5", "25h9", "36h10", "36h11")),
)
"""Marker sets that OpenCV knows by name."""


class SourceSection(Section):
    """Where the data come from; printed, never interpreted."""

    citation: Prose | None = None
    doi: Line | None = None
    url: Line | None = None
    license: Line | None = None
    notes: Prose | None = None


class BoardSection(Section):
    """The calibration board; `columns` and `rows` count inner corners.

    `corners` is a corner cache in mrcal's format; `target` the corner that is gazed at; `detector`
    forces one of the chessboard detectors, which `cascade` tries in turn.
    """

    type: Literal["chessboard", "charuco"]
    columns: CornerCount
    rows: CornerCount
    square_mm: SquareMm
    corners: Line | None = None
    target: Target = None
    dictionary: Line | None = None
    marker_mm: Positive | None = None
    legacy: Flag = False
    detector: Literal["cascade", "classic", "sector"] = "cascade"

    @property
    def has_centre(self) -> bool:
        """Whether one corner is the board's centre."""
        return self.columns % 2 == 1 and self.rows % 2 == 1

    @property
    def target_corner(self) -> tuple[int, int] | None:
        """Column and row of the gazed corner; None if unstated on a board without a centre."""
        if isinstance(self.target, tuple):
            return self.target
        return (self.columns // 2, self.rows // 2) if self.has_centre else None

    @model_validator(mode="after")
    def _check_target(self) -> BoardSection:
        if self.target == "centre" and not self.has_centre:
            refuse(
                f'target = "centre", but no corner of {self.columns} x {self.rows} is the centre',
                "give the gazed corner as [column, row], counted from 0",
            )
        if isinstance(self.target, tuple):
            column, row = self.target
            if column >= self.columns or row >= self.rows:
                refuse(
                    f"target [{column}, {row}] is not on the board",
                    f"columns run from 0 to {self.columns - 1}, rows from 0 to {self.rows - 1}",
                )
        return self

    @model_validator(mode="after")
    def _check_markers(self) -> BoardSection:
        if self.type == "chessboard":
            if self.dictionary is not None or self.marker_mm is not None or self.legacy:
                refuse(
                    "a chessboard has no dictionary, marker_mm or legacy",
                    'remove them, or write type = "charuco"',
                )
            return self
        if self.dictionary is None or self.marker_mm is None:
            refuse(
                "a charuco board needs dictionary and marker_mm",
                'add, for example, dictionary = "DICT_5X5_100" and marker_mm = 15.0',
            )
        if self.dictionary not in DICTIONARIES:
            refuse(
                f"unknown dictionary {shown(self.dictionary)}",
                suggestion(self.dictionary, DICTIONARIES),
            )
        if self.marker_mm >= self.square_mm:
            refuse(
                f"marker_mm = {self.marker_mm:g} does not fit into square_mm = {self.square_mm:g}",
                "check that they are not exchanged",
            )
        return self


class CameraSection(Section):
    """One camera: images of the board, a finished model, or given intrinsics.

    `projection` says of which lens model `distortion` is: "perspective" where it is left out.
    `exclude` names images that are left out. `u_focal`, relative, and `u_centre_px` are standard
    uncertainties of a lens that is given; without them `calib.dataset.given_lens` has some.
    """

    image_size: tuple[Pixels, Pixels] | None = None
    images: Line | None = None
    exclude: tuple[Line, ...] = ()
    model: Line | None = None
    matrix: CameraMatrix | None = None
    distortion: tuple[Number, ...] | None = None
    projection: ProjectionName | None = None
    u_focal: UFocal | None = None
    u_centre_px: NotNegative | None = None

    @model_validator(mode="after")
    def _check_source(self) -> CameraSection:
        sources = [n for n in ("images", "model", "matrix") if getattr(self, n) is not None]
        if len(sources) != 1:
            what = " and ".join(sources) + " are given" if sources else "none is given"
            refuse(
                f"exactly one of images, model and matrix is needed, {what}",
                "keep the one the intrinsics are to come from",
            )
        if self.image_size is None and self.matrix is not None:
            refuse("image_size is missing", "add image_size = [width, height] in pixels")
        return self

    @model_validator(mode="after")
    def _check_matrix(self) -> CameraSection:
        if self.exclude and self.images is None:
            refuse("exclude is given without images", "remove it")
        if self.images is not None and (self.u_focal, self.u_centre_px) != (None, None):
            refuse(
                "u_focal or u_centre_px is given with images",
                "remove it: the images tell what is uncertain",
            )
        if self.distortion is not None and self.matrix is None:
            refuse("distortion is given without matrix", "give both, or neither")
        if self.projection is not None and self.matrix is None:
            refuse("projection is given without matrix", "remove it: pictures and models tell it")
        refuse_coefficients(self.projection, self.distortion)
        if self.matrix is not None and self.image_size is not None:
            centre = self.matrix[0][2], self.matrix[1][2]
            if not all(0 < c < size for c, size in zip(centre, self.image_size, strict=True)):
                refuse(
                    f"the principal point ({centre[0]:g}, {centre[1]:g}) lies outside the image",
                    "check matrix and image_size; they must belong to images of one size",
                )
            slip = lens_fault(
                np.array(self.matrix), self.distortion or (), self.image_size, self.projection
            )
            if slip is not None:
                refuse(f"matrix: {slip[0]}", slip[1])
        return self


class CamerasSection(Section):
    """The monitor camera C1 and the gazing camera C2."""

    c1: CameraSection | None = None
    c2: CameraSection | None = None


class StereoSection(Section):
    """The stereo reference: C2 held at one yaw. `transform` is 1T2, the pose of C2 in C1.

    `exclude` names an image of each pair that is left out.
    """

    c1: Line | None = None
    c2: Line | None = None
    exclude: tuple[Line, ...] = ()
    alpha2_deg: AngleDeg | None = None
    transform: Pose | None = None

    @property
    def has_images(self) -> bool:
        """Whether there are image pairs."""
        return self.c1 is not None

    @model_validator(mode="after")
    def _check_source(self) -> StereoSection:
        if (self.c1 is None) != (self.c2 is None):
            refuse("only one of c1 and c2 is given", "give the images of both cameras")
        if self.c1 is None and self.transform is None:
            refuse("neither image pairs nor a transform are given", "add c1 and c2, or transform")
        if self.exclude and not self.has_images:
            refuse("exclude is given without image pairs", "remove it")
        if self.transform is None and self.alpha2_deg is None:
            refuse("alpha2_deg is missing", "add the encoder reading while the pairs were taken")
        return self


class RigSection(Section):
    """The rig: the side of C1 on which C2 stands, +X or -X, and the rig's serial number."""

    c2: Literal["right", "left"] = "right"
    serial: Line | None = None

    @property
    def is_left(self) -> bool:
        """Whether C2 stands at -X of C1."""
        return self.c2 == "left"


class GazeSection(Section):
    """Calibration rows, and the standard uncertainties of rows that state none.

    `u_z_group_mm` and `u_z_group_rel` are of the error of z that rows of one group have in common,
    beside each row's own. `z_from` says from where z_mm counts.
    """

    table: Line
    reference: Line = "not stated"
    z_from: DepthOrigin | None = None
    u_x1c: UX1c = DEFAULT_U_X1C
    u_z_mm: NotNegative = 0.0
    u_z_rel: UZRel = 0.0
    u_z_group_mm: NotNegative = 0.0
    u_z_group_rel: UZRel = 0.0

    @property
    def origin(self) -> DepthOrigin | None:
        """From where z_mm counts; None where nothing says it."""
        return origin_of(self.z_from, self.reference)


class ValidationSection(Section):
    """Rows that are never used to fit; `reference` says what their z_mm is.

    Where `z_from` is not given, z_mm counts from where that of the calibration rows does.
    """

    table: Line
    reference: Line = "not stated"
    z_from: DepthOrigin | None = None
    u_z_mm: NotNegative = 0.0
    u_z_rel: UZRel = 0.0
    u_z_group_mm: NotNegative = 0.0
    u_z_group_rel: UZRel = 0.0

    @property
    def origin(self) -> DepthOrigin | None:
        """From where z_mm counts; None where nothing says it."""
        return origin_of(self.z_from, self.reference)


class TableSection(Section):
    """A section that names a table and nothing else, such as lengths."""

    table: Line


class Returns(TableSection):
    """Returns to the first target while rows were captured: whether the zero stood still."""


class CorrectionsSection(Section):
    """A diagnosed cause that is accepted: the rows are corrected by its estimate."""

    accept: AcceptedCause


class SweepSection(TableSection):
    """The yaw sweep; `exclude` names images that are left out."""

    exclude: tuple[Line, ...] = ()


class ToleranceSection(Section):
    """What depth is certified against, in parts of z."""

    depth_rel: DepthTolerance


class CertificateSection(Section):
    """What the certificate prints; "not stated" where it is silent.

    `replaces` is the identifier of the certificate that this one amends, `amendment` the reason.
    `next_calibration` is for a customer who has asked for a date (ISO/IEC 17025:2017, 7.8.4.3).
    """

    laboratory: Line | None = None
    address: Prose | None = None
    customer: Prose | None = None
    instrument: Line | None = None
    serial: Line | None = None
    condition: Prose | None = None
    received: Day | None = None
    location: Line | None = None
    date: Day | None = None
    operator: Line | None = None
    approved_by: Line | None = None
    temperature_c: Number | None = None
    humidity_percent: Percent | None = None
    deviations: Prose | None = None
    country: Country | None = None
    replaces: Line | None = None
    amendment: Prose | None = None
    next_calibration: Day | None = None
    tolerance: ToleranceSection | None = None
    decision_rule: Literal["simple", "guard-band"] = "simple"

    @model_validator(mode="after")
    def _check_amendment(self) -> CertificateSection:
        if self.amendment is not None and self.replaces is None:
            refuse(
                "amendment is given without replaces",
                "add replaces, the identifier of the certificate that is amended",
            )
        return self


class Manifest(Section):
    """A whole dataset.toml."""

    format: Literal[1]
    name: Line
    title: Line = ""
    source: SourceSection = SourceSection()
    rig: RigSection = RigSection()
    board: BoardSection | None = None
    cameras: CamerasSection = CamerasSection()
    stereo: StereoSection | None = None
    encoder: Encoder | None = None
    gaze: GazeSection | None = None
    validation: ValidationSection | None = None
    sweep: SweepSection | None = None
    lengths: TableSection | None = None
    returns: Returns | None = None
    priors: Priors = Field(default_factory=dict)
    corrections: CorrectionsSection | None = None
    published: Published = Field(default_factory=dict)
    certificate: CertificateSection = CertificateSection()

    @property
    def heading(self) -> str:
        """What reports call the dataset."""
        return self.title or self.name

    def camera(self, name: str) -> CameraSection | None:
        """Return the section of camera "c1" or "c2"."""
        return {"c1": self.cameras.c1, "c2": self.cameras.c2}[name]
