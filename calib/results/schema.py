"""calibration.json as programs may rely on it, for its JSON Schema.

Parts that a dataset has no data for are absent. Lengths are mm, angles rad; covariances are in the
units of what they are of.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from calib.geometry.parameters import PARAMETERS

Vector = list[float]
Matrix = list[list[float]]

_UNITS = ", ".join(f"{p.name} ({p.meaning})" for p in PARAMETERS)


class Part(BaseModel):
    """A section; it holds the keys below and no others."""

    model_config = ConfigDict(extra="forbid")


class DatasetPart(Part):
    """What was calibrated from."""

    name: str
    sha256: str = Field(description="of manifest, tables and images, names and bytes")
    rows: int | None = Field(None, description="number of gaze rows")
    rows_sketch: list[str] | None = Field(
        None, description="smallest digests of the rows: by them runs see whether they share some"
    )


class RigPart(Part):
    """The rig."""

    c2: Literal["right", "left"] = Field(description="side of C1 on which C2 stands")
    serial: str | None = Field(None, description="of the rig, as the manifest states it")


class Lens(Part):
    """A solve of one camera's intrinsics."""

    lens_model: str
    matrix: Matrix = Field(description="px, the centre of the top-left pixel is (0, 0)")
    distortion: Vector = Field(description="OpenCV's order")
    image_size: tuple[int, int]
    std: Vector | None = Field(None, description="of fx, fy, cx, cy, distortion")
    rms_px: float | None = Field(None, description="of the corners' residuals")
    rejected_points: int | None = Field(None, description="corners left out as outliers")
    views: int | None = Field(None, description="pictures used")
    board_warp_mm: Vector | None = None


class JointLens(Part):
    """A joint solve of lenses and pairs that refined the intrinsics."""

    images: dict[Literal["lens", "pair", "row"], int] = Field(
        description="images of the camera by what they were taken for"
    )


class Intrinsics(Lens):
    """The selected intrinsics of one camera."""

    source: Literal["mrcal", "opencv", "given"] = Field(
        description="whose solve of the camera's own pictures; a joint solve may have refined it"
    )
    joint: JointLens | None = None
    covariance: Matrix | None = Field(None, description="of fx, fy, cx, cy, distortion; px and 1")
    dispersion: float | None = Field(
        None,
        description="variance as views show it over that of corner noise alone; in covariance",
    )
    selection: str | None = Field(None, description="why this solve was selected, in words")
    rejected_views: list[str] | None = None
    alternatives: dict[str, dict[str, Lens]] | None = Field(
        None, description="all solves, by backend and lens model"
    )


class StereoSolve(Part):
    """One solve of the pose."""

    backend: str
    intrinsics: str
    pose_12: Vector = Field(description="Rodrigues vector and translation")
    std: Vector
    rms_px: float


class PairTarget(Part):
    """The target of one pair."""

    pair: str
    position_mm: Vector
    u_z_mm: float


class StereoPart(Part):
    """The pose of C2 in C1's frame, C2 held at one yaw."""

    source: str = Field(description="how the pose was found")
    transform_12: Matrix = Field(description="4 x 4, P1 = R P2 + t: takes a point of C2 to C1, mm")
    covariance: Matrix | None = Field(
        description="of rotation vector, rad, and translation, mm, of transform_12"
    )
    baseline_mm: float = Field(description="distance of the cameras' centres")
    baseline_std_mm: float | None = Field(description="its standard uncertainty")
    rms_px: float | None = Field(description="of the pairs' residuals")
    pairs: int = Field(description="how many were used")
    alternatives: list[StereoSolve]
    targets: list[PairTarget]


class Estimate(Part):
    """A value with its standard uncertainty."""

    value: float
    std: float = Field(description="standard uncertainty")


class Measured(Part):
    """Jointly measured parameters."""

    names: list[str]
    mean: Vector
    covariance: Matrix


class SweepPart(Part):
    """The yaw axis by a sweep of C2 before boards at rest."""

    axis_direction_c2: Vector
    axis_foot_c2_mm: Vector
    eccentricity_mm: Estimate
    gaze_roll_rad: Estimate
    encoder_scale: Estimate
    measured: Measured
    rms_px: float
    images: int


IdentifiedBy = Literal["data", "prior", "both"]


class Parameter(Estimate):
    """An estimated parameter."""

    identified_by: IdentifiedBy | None = None
    std_over_data_only_std: float | None = Field(None, description="robust fits")
    q2_5: float | None = Field(None, alias="q2.5", description="posteriors, as all below")
    q50: float | None = Field(None, description="median")
    q97_5: float | None = Field(None, alias="q97.5")
    ess: float | None = Field(None, description="effective draws in the bulk")
    ess_tail: float | None = Field(None, description="effective draws in the tails")
    rhat: float | None = Field(None, description="R-hat across ensembles")


class Derived(Estimate):
    """A quantity that follows from the parameters of a fit."""

    q2_5: float | None = Field(None, alias="q2.5", description="posteriors, as q97.5")
    q97_5: float | None = Field(None, alias="q97.5")


class Fit(Part):
    """A fit; NAME/linear, NAME/convex, NAME/robust, NAME/posterior or NAME/adjustment."""

    parameters: Annotated[dict[str, Parameter], Field(description=_UNITS)]
    names: list[str] = Field(description="order of the covariance")
    covariance: Matrix
    derived: dict[str, Derived] | None = Field(None, description="effective_baseline_mm: L_b + e")
    residual_mrad: Vector | None = Field(None, description="angle of each row to its gaze plane")
    sigma_mrad: float | None = Field(
        None, description="standard deviation of the residuals of rows that are no outliers"
    )
    outliers: list[str] | None = Field(
        None, description="ids of rows that disagree with the others"
    )
    diagnostics: dict[str, Any] | None = None
    converged: bool | None = Field(None, description="posteriors, as all below")
    tau: dict[str, float] | None = Field(None, description="autocorrelation time, steps")
    draws: int | None = Field(None, description="of the posterior that were kept")
    steps: int | None = Field(None, description="of each ensemble, without burn-in")
    acceptance: float | None = Field(None, description="share of proposals accepted")
    importance: dict[str, Any] | None = Field(
        None, description="the same moments by importance sampling, and whether they agree"
    )


class AdjustedCamera(Part):
    """A camera by the adjustment; without uncertainty if it was given."""

    matrix: Matrix
    distortion: Vector
    image_size: list[int]
    std: Vector | None = Field(None, description="fx, fy, cx, cy, distortion")
    covariance: Matrix | None = Field(None, description="of fx, fy, cx, cy, distortion; px and 1")


class AdjustedStereo(Part):
    """Pose of C2 in C1 at a reading, by the adjustment."""

    alpha2_deg: float
    transform_12: Matrix = Field(description="4 x 4, P1 = R P2 + t: takes a point of C2 to C1, mm")
    covariance: Matrix = Field(description="of rotation vector and translation")
    baseline_mm: float = Field(description="distance of the cameras' centres")
    baseline_std_mm: float


class AdjustedReadings(Part):
    """Errors of the encoder's readings."""

    count: int
    stated_std_rad: float
    std_rad: float = Field(description="as the pictures show it")


class AdjustmentPart(Part):
    """All pictures in one least squares: lenses, board, rig, encoder and readings."""

    model: str = Field(description="of record; `complete` has every parameter free")
    passed: bool
    intrinsics: dict[Literal["c1", "c2"], AdjustedCamera]
    stereo: AdjustedStereo
    pictures: dict[str, int] = Field(description="how many, by camera and purpose")
    left_out: list[str] = Field(description="pictures that contradict the others")
    rejected_points: int
    rms_px: float
    sigma_px: dict[str, float] = Field(description="of a corner, by camera and purpose")
    readings: AdjustedReadings
    gates: list[GatePart]


class Score(Part):
    """How well one model predicts."""

    model: str
    loo: float = Field(description="expected log predictive density, leave one out, nats")
    loo_se: float = Field(description="standard error of loo")
    aicc: float | None = Field(
        None, description="Akaike's criterion, corrected; absent with too few rows"
    )
    bic: float = Field(description="Schwarz's criterion")
    cv_depth_rms_rel: float | None = Field(
        None,
        description="rms of relative depth errors, each group of rows predicted without it",
    )
    validation_depth_rms_rel: float | None = Field(
        None, description="the same of the validation rows"
    )
    weight: float = Field(description="stacking")
    averaging_weight: float = Field(description="pseudo-BMA+")
    pareto_k_max: float = Field(description="greatest k-hat of the rows")
    refitted: list[str] = Field(
        description="rows predicted by an exact refit, as their k-hat was too high"
    )
    unreliable: list[str] = Field(description="rows whose refit's own importance weights were poor")


class Spread(Part):
    """Standard deviation of a normal part and full width of a rectangular one."""

    normal: float
    width: float


class Stated(Part):
    """What the manifest states of readings."""

    u_x1c: float
    encoder_step_rad: float
    u_alpha2_rad: float


class Reading(Part):
    """Errors of a reading."""

    x1c: Spread
    y1c: Spread
    alpha2_rad: Spread
    gaze_residual_rad: Spread


class Shared(Part):
    """Errors that readings have in common with the rows."""

    names: list[str]
    factor: Matrix
    with_parameters: Matrix
    sources: list[str]


class SharedByRows(Part):
    """Errors that the rows alone have in common."""

    with_parameters: Matrix
    sources: list[str]


class ModelPart(Part):
    """One model as it measures."""

    model: str
    names: list[str] = Field(description="order of values and covariance")
    values: Vector = Field(description="of the parameters")
    covariance: Matrix
    noise_factor: float = Field(
        description="by how much the rows proved the stated uncertainties of a reading too small"
    )
    factor95: float = Field(description="coverage factor of inverse depth")


class AveragePart(ModelPart):
    """One model in the average."""

    weight: float
    with_parameters: Matrix | None = None


class ByOneModel(ModelPart):
    """All that measuring by one model needs."""

    stated: Stated
    reading: Reading
    calibrated_depth_mm: tuple[float, float] = Field(
        description="ends of the depths that the calibration covers"
    )
    shared: Shared | None = None
    shared_by_rows: SharedByRows | None = None


class AdjustedMeasurement(ByOneModel):
    """All that measuring by the adjustment needs."""

    cameras: dict[Literal["c1", "c2"], AdjustedCamera]


class Measurement(ByOneModel):
    """All that measuring needs: by the rows, of the selected model; by the adjustment."""

    average: list[AveragePart] | None = None
    adjustment: AdjustedMeasurement | None = None


class Depth(Part):
    """Depth uncertainty at one depth, for a target on C1's optical axis."""

    z_mm: float
    u_mm: float | None = Field(None, description="standard uncertainty by Monte Carlo")
    low95_mm: float | None = None
    high95_mm: float | None = None
    gum_u_mm: float = Field(description="by the linear law")
    gum_valid: bool = Field(description="verdict of JCGM 101, clause 8")
    extrapolated: bool
    gum_sources_mm: dict[str, float]


class AverageDepth(Part):
    """The same by all models together."""

    z_mm: float
    mean_mm: float
    u_mm: float
    low95_mm: float | None = None
    high95_mm: float | None = None


class ValidationRow(Part):
    """A validation row as measured."""

    id: str
    group: str
    x_mm: float
    y_mm: float
    z_mm: float
    u_mm: float | None = None
    low95_mm: float | None = None
    high95_mm: float | None = None
    reference_mm: float
    error_rel: float
    other_references_error_rel: dict[str, float]
    own_angle_z_mm: dict[str, float]


class CausePart(Part):
    """A mistake that calibration rows or independent references show."""

    cause: str = Field(description="name of a hypothesis")
    at: str | None = Field(None, description="row, rows or group where it struck")
    seen_in: Literal["rows", "references"] = Field(
        "rows", description="whether calibration rows or independent references show it"
    )
    estimate: float | None = None
    std: float | None = None
    unit: str
    gain: float = Field(
        description="evidence, nats: gain in log marginal likelihood less penalties"
    )
    noise_scale: tuple[float, float] = Field(description="without and with it")
    depth_change_over_u: float = Field(description="largest, if it is left out")
    in_model: bool = Field(description="whether the model allows for it already")
    text: str
    remedy: str
    fits_as_well: list[str] = Field(description="causes that explain the rows about as well")
    told_apart_by: str


class CorrectionPart(Part):
    """A cause that the manifest accepts: the rows are corrected by its estimate."""

    cause: str
    at: str | None = None
    estimate: float | None = None
    std: float | None = None
    unit: str
    text: str


class StructurePart(Part):
    """A test of the selected model's residuals by an added regressor."""

    against: str
    at: str | None = None
    probability: float = Field(description="of so much by chance")


class GatePart(Part):
    """A check of the result."""

    name: str
    passed: bool
    detail: str


class Integrity(Part):
    """By which an edit is noticed."""

    sha256: str = Field(
        description="of the document without this section, as compact JSON with sorted keys"
    )


class Document(Part):
    """The result of a calibration, for programs."""

    format: Literal[1]
    generator: str
    dataset: DatasetPart
    rig: RigPart
    seed: int
    intrinsics: dict[Literal["c1", "c2"], Intrinsics] | None = None
    stereo: StereoPart | None = None
    sweep: SweepPart | None = None
    fits: dict[str, Fit] | None = None
    adjustment: AdjustmentPart | None = None
    identifiability: dict[str, dict[str, Any]] | None = None
    comparison: list[Score] | None = None
    selected: str | None = None
    selection_rule: str | None = None
    method: Literal["rows", "adjustment"] | None = Field(
        None, description="by which the instrument of record is; absent: by the rows"
    )
    method_rule: str | None = Field(None, description="why")
    measurement: Measurement | None = None
    depth_uncertainty: list[Depth] | None = None
    depth_uncertainty_average: list[AverageDepth] | None = None
    validation: list[ValidationRow] | None = None
    validation_summary: dict[str, dict[str, float]] | None = None
    diagnosis: list[CausePart] | None = Field(None, description="best first")
    residual_structure: list[StructurePart] | None = None
    corrections: list[CorrectionPart] | None = None
    not_fitted: dict[str, str] | None = None
    gates: list[GatePart]
    warnings: list[str]
    contradictions: list[str] | None = Field(
        default=None,
        description="of the warnings, those of a validation reference that contradicts the depths",
    )
    integrity: Integrity
