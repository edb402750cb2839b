"""From what is known so far to what the advice starts from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.checks.verdict import outliers_gate, residuals_gate
from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError, UsageError
from calib.core.gate import Gate, failed
from calib.dataset.contents import Dataset
from calib.dataset.manifest import DEFAULT_U_X1C
from calib.fit.information import row_information
from calib.fit.priors import NormalKnowledge, Priors, measured_of, prior_of
from calib.fit.robust import fit_robust, too_much
from calib.fit.scale import scaled_defaults
from calib.fit.start import first_guess
from calib.geometry.parameters import INDEX, MODELS, Model, embed, model_for
from calib.geometry.plane import OBSERVABLE
from calib.plan.design import Knowledge, RowNoise, row_vectors
from calib.plan.field import Field, field_of
from calib.plan.prior_knowledge import PriorKnowledge
from calib.rows.from_table import RowSettings, row_priors, row_settings
from calib.rows.observations import Observations

ASSUMED_U_Z_REL = 0.002
"""Relative uncertainty of a reference depth where no [gaze] states one: a laser distance meter, or
stereo with a baseline of a decimetre, at a metre."""


@dataclass(frozen=True)
class PlanStart:
    """What the advice starts from.

    Parameters
    ----------
    knowledge, field, noise
        See `calib.plan.advise.advise`.
    between_mm
        Depths at which targets can be put.
    points_mm
        Targets of the rows so far, frame C1, shape (n, 3).
    notes
        What had to be assumed.
    failed_gates
        Of rows and pictures so far: the advice rests on what they say cannot be relied on.
    """

    knowledge: Knowledge
    field: Field
    noise: RowNoise
    between_mm: tuple[float, float]
    points_mm: FloatArray
    notes: tuple[str, ...]
    failed_gates: tuple[Gate, ...] = ()


def prepare(
    dataset: Dataset,
    prior_knowledge: PriorKnowledge,
    *,
    model: str,
    asked_mm: FloatArray,
    targets_mm: tuple[float, float] | None,
    yaw_deg: tuple[float, float],
) -> PlanStart:
    """Return the start: the fit of the rows so far, or the priors if there are no rows.

    Raises
    ------
    UsageError
        If the model is unknown, or without rows it is not known what the baseline is, where C1
        looks, or at which depths targets can be put.
    """
    if model not in MODELS:
        raise UsageError(f"--model {model}: unknown; choose from {', '.join(MODELS)}")
    rows = prior_knowledge.rows
    defaults = {} if rows is None else scaled_defaults(rows)
    priors = Priors(defaults | row_priors(dataset), prior_knowledge.measured)
    settings, notes = _settings(dataset)
    gates = prior_knowledge.failed_gates
    if rows is None:
        knowledge = _from_priors(MODELS[model], priors, prior_knowledge.baseline_mm)
        points = np.zeros((0, 3))
    else:
        learnt = model_for(model, off_centre=rows.off_centre, offset_open=priors.offset_open)
        knowledge, more, failing = _from_rows(learnt, priors, rows)
        notes, gates = notes + more, gates + failing
        if rows.shared_names:
            notes += ("errors that all rows share, of intrinsics and stereo, come on top of u(z)",)
        points = rows.z_mm[:, None] * np.column_stack([rows.x1c, rows.y1c, np.ones(len(rows))])
    field, unseen = _field(prior_knowledge, yaw_deg)
    return PlanStart(
        knowledge=knowledge,
        field=field,
        noise=_noise(settings, rows),
        between_mm=targets_mm or _between(points[:, 2], asked_mm),
        points_mm=points,
        notes=notes + unseen,
        failed_gates=gates,
    )


def _field(
    prior_knowledge: PriorKnowledge, yaw_deg: tuple[float, float]
) -> tuple[Field, tuple[str, ...]]:
    """Return where targets can be seen and gazed at, and what had to be assumed."""
    rows, cameras = prior_knowledge.rows, prior_knowledge.cameras
    notes: tuple[str, ...] = ()
    if cameras.c1 is None:
        if rows is None:
            raise UsageError(
                "without gaze rows it is not known where C1 looks; give [cameras.c1] in "
                "dataset.toml, with matrix and image_size, a model file or images"
            )
        notes = ("C1's lens is not known: targets stay within the x1c and y1c of the rows so far",)
    nothing = np.zeros(0)
    field = field_of(
        cameras.c1,
        cameras.c2,
        seen_x1c=nothing if rows is None else rows.x1c,
        seen_y1c=nothing if rows is None else rows.y1c,
        yaw_rad=(float(np.deg2rad(yaw_deg[0])), float(np.deg2rad(yaw_deg[1]))),
    )
    return field, notes


def _between(seen_mm: FloatArray, asked_mm: FloatArray) -> tuple[float, float]:
    every = np.concatenate([seen_mm, asked_mm])
    near, far = float(every.min()), float(every.max())
    if near == far:
        raise UsageError(
            f"targets at {near:g} mm alone tell little; say at which depths they can be put: "
            "--targets NEAR FAR"
        )
    return near, far


def _settings(dataset: Dataset) -> tuple[RowSettings, tuple[str, ...]]:
    """Return how uncertain a row will be, and what had to be assumed for it."""
    if dataset.manifest.encoder is None:
        raise UsageError(
            f"{dataset.root}: without [encoder] in dataset.toml it is not known how uncertain a "
            "row will be; add it, with resolution_deg"
        )
    if dataset.manifest.gaze is not None:
        return row_settings(dataset), ()
    encoder = dataset.manifest.encoder
    assumed = RowSettings(
        u_x1c=DEFAULT_U_X1C,
        u_z_mm=0.0,
        u_z_rel=ASSUMED_U_Z_REL,
        encoder_step_rad=float(np.deg2rad(encoder.resolution_deg)),
        u_alpha2_rad=float(np.deg2rad(encoder.further_u_deg)),
    )
    note = (
        f"no [gaze] in dataset.toml: u(x1c) = {DEFAULT_U_X1C:g} and u(z) = "
        f"{100 * ASSUMED_U_Z_REL:g} % of z are assumed of the rows to come"
    )
    return assumed, (note,)


def _noise(settings: RowSettings, rows: Observations | None) -> RowNoise:
    """Return the uncertainty of a row to come: that of the rows so far, or as stated."""
    if rows is None:
        reading = np.zeros(OBSERVABLE.z)
        reading[OBSERVABLE.x1c] = reading[OBSERVABLE.y1c] = settings.u_x1c
        step = settings.encoder_step_rad / np.sqrt(12)
        reading[OBSERVABLE.alpha2] = np.hypot(step, settings.u_alpha2_rad)
        mm = float(np.hypot(settings.u_z_mm, settings.u_z_group_mm))
        return RowNoise(reading, mm, float(np.hypot(settings.u_z_rel, settings.u_z_group_rel)))
    reading = np.median(rows.std[:, : OBSERVABLE.z], axis=0)
    return RowNoise(reading, *_depth_noise(rows.z_mm, rows.std[:, OBSERVABLE.z]))


def _depth_noise(z_mm: FloatArray, u_mm: FloatArray) -> tuple[float, float, float]:
    """Return u(z), u(z) / z and u(z) / z² of the rows' references: the one that varies least.

    A ruler has the first, a laser distance meter the second, stereo the third; the others are 0.
    """
    if not (u_mm > 0).all():
        return float(np.median(u_mm)), 0.0, 0.0
    logs = [np.log(u_mm) - power * np.log(z_mm) for power in range(3)]
    best = int(np.argmin([np.std(log) for log in logs]))
    size = float(np.exp(np.median(logs[best])))
    mm, rel, square = (size if best == power else 0.0 for power in range(3))
    return mm, rel, square


def _known(model: Model, priors: Priors) -> NormalKnowledge:
    """Return what is known without rows: priors and the sweep."""
    return prior_of(model, priors) + measured_of(model, priors)


def _from_rows(
    model: Model, priors: Priors, rows: Observations
) -> tuple[Knowledge, tuple[str, ...], tuple[Gate, ...]]:
    """Return what rows, sweep and priors say together, what had to be assumed, what failed."""
    precision = _known(model, priors).precision
    reason = too_much(rows, model)
    try:
        fit = fit_robust(rows, model, priors)
    except EstimationError as error:
        reason = reason or str(error)
        theta = first_guess(rows)
    else:
        theta = fit.theta
        if reason is None:
            information = _without_groups(row_information(rows, fit) + precision, fit.by_groups)
            gates = failed((residuals_gate(fit), outliers_gate(fit)))
            return Knowledge(model, theta, information, fit.noise_scale), (), gates
    # Too few rows to judge their noise: as stated, it will do to tell where more belong.
    before = Knowledge(model, theta, precision)
    slope = row_vectors(before, rows)
    note = f"too little for {model.name} yet ({reason}): uncertainties are taken as stated"
    return Knowledge(model, theta, slope.T @ slope + precision), (note,), ()


def _without_groups(information: FloatArray, by_groups: FloatArray) -> FloatArray:
    """Return the information, (p, p), that is left where groups of rows err together.

    The inverse of the covariance with what they add, by_groups @ by_groups.T (Woodbury).
    """
    carried = information @ by_groups
    inner = np.eye(by_groups.shape[1]) + by_groups.T @ carried
    left: FloatArray = information - carried @ np.linalg.solve(inner, carried.T)
    return left


def _from_priors(model: Model, priors: Priors, baseline_mm: float | None) -> Knowledge:
    """Return what priors and sweep say together; the baseline perhaps from the stereo reference."""
    known = _known(model, priors)
    mean = np.linalg.pinv(known.precision, hermitian=True) @ known.shift
    if "baseline_mm" not in priors.stated:
        if baseline_mm is None:
            raise UsageError(
                "without gaze rows the plan needs a prior of baseline_mm in dataset.toml: what a "
                "ruler says will do"
            )
        mean[model.indices.index(INDEX["baseline_mm"])] = baseline_mm
    return Knowledge(model, embed(mean, model.free), known.precision)
