"""From a dataset to what the advice starts from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray
from calib.dataset.contents import Dataset
from calib.errors import UsageError
from calib.fit.identifiability import row_information
from calib.fit.priors import Priors, prior_of
from calib.fit.robust import fit_model
from calib.geometry.parameters import MODELS, Model, vector
from calib.geometry.plane import OBSERVABLE
from calib.observations import Observations
from calib.observe import CameraSet, Setup, observe, row_settings
from calib.plan.design import Knowledge, Noise
from calib.plan.field import Field, field_of


@dataclass(frozen=True)
class Start:
    """What the advice starts from.

    Parameters
    ----------
    knowledge, field, noise
        See `calib.plan.advise.advise`.
    between_mm
        Depths at which targets can be put.
    points_mm
        Targets of the rows so far, frame C1, shape (n, 3).
    """

    knowledge: Knowledge
    field: Field
    noise: Noise
    between_mm: tuple[float, float]
    points_mm: FloatArray


def prepare(
    dataset: Dataset,
    *,
    model: str,
    asked_mm: FloatArray,
    targets_mm: tuple[float, float] | None,
    yaw_deg: tuple[float, float],
) -> Start:
    """Return the start: the fit of the rows so far, or the priors if there are no rows.

    Raises
    ------
    UsageError
        If the model is unknown, or without rows the manifest does not say how uncertain they will
        be, what the baseline is or where C1 looks.
    EstimationError
        If the rows cannot carry the model.
    """
    if model not in MODELS:
        raise UsageError(f"--model {model}: unknown; choose from {', '.join(MODELS)}")
    stated = {name: (prior.mean, prior.std) for name, prior in dataset.manifest.priors.items()}
    priors, cameras = Priors(stated), dataset.cameras
    if dataset.manifest.gaze is None or dataset.manifest.encoder is None:
        raise UsageError(
            f"{dataset.root}: without [gaze] and [encoder] in dataset.toml it is not known how "
            "uncertain a row will be; add them, the table may be empty of rows but for its head"
        )
    settings = row_settings(dataset)
    rows = None
    if dataset.gaze is not None and len(dataset.gaze):
        setup = Setup(settings, CameraSet(cameras.get("c1"), cameras.get("c2")))
        rows = observe(dataset.gaze, setup, None)
        _refuse_images(dataset, rows)
    knowledge = _knowledge(MODELS[model], priors, rows)
    field = field_of(
        cameras.get("c1"),
        cameras.get("c2"),
        seen_x1c=np.zeros(0) if rows is None else rows.x1c,
        seen_y1c=np.zeros(0) if rows is None else rows.y1c,
        yaw_rad=(float(np.deg2rad(yaw_deg[0])), float(np.deg2rad(yaw_deg[1]))),
    )
    if rows is None:
        reading = np.zeros(OBSERVABLE.z)
        reading[OBSERVABLE.x1c] = reading[OBSERVABLE.y1c] = settings.u_x1c
        step = settings.encoder_step_rad / np.sqrt(12)
        reading[OBSERVABLE.alpha2] = np.hypot(step, settings.u_alpha2_rad)
        points = np.zeros((0, 3))
    else:
        reading = np.median(rows.std[:, : OBSERVABLE.z], axis=0)
        points = rows.z_mm[:, None] * np.column_stack([rows.x1c, rows.y1c, np.ones(len(rows))])
    every = np.concatenate([points[:, 2], asked_mm])
    return Start(
        knowledge=knowledge,
        field=field,
        noise=Noise(reading, settings.u_z_mm, settings.u_z_rel),
        between_mm=targets_mm or (float(every.min()), float(every.max())),
        points_mm=points,
    )


def _refuse_images(dataset: Dataset, rows: Observations) -> None:
    known = np.isfinite(rows.x1c) & np.isfinite(rows.z_mm) & np.isfinite(rows.std).all(axis=1)
    if not known.all():
        raise UsageError(
            f"{dataset.root}: row {rows.ids[int(np.argmin(known))]} of the gaze table needs images "
            "to be measured; plan reads tables alone: give x1c (or u1_px) and z_mm there"
        )


def _knowledge(model: Model, priors: Priors, rows: Observations | None) -> Knowledge:
    """Return what rows and priors say together."""
    prior = prior_of(model, priors)
    if rows is not None:
        fit = fit_model(rows, priors, model=model.name)
        information = row_information(rows, fit) + prior.precision
        return Knowledge(model, fit.theta, information, fit.noise_scale)
    if "baseline_mm" not in priors.stated:
        raise UsageError(
            "without gaze rows the plan needs a prior of baseline_mm in dataset.toml: what a ruler "
            "says will do"
        )
    means = {name: mean for name, (mean, _) in priors.stated.items() if name in model.free}
    return Knowledge(model, vector(means), prior.precision)
