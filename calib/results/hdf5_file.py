"""results.h5: every array of a calibration, each with its unit and what it is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import h5py
import numpy as np

from calib.core.arrays import FloatArray
from calib.core.hdf5 import hdf5_bytes
from calib.fit.identifiability import Identifiability
from calib.fit.posterior import Posterior
from calib.fit.robust import RobustFit
from calib.geometry.parameters import INDEX, PARAMETERS
from calib.images.adjustment.result import Adjustment
from calib.results.calibration import Calibration, GazeResult
from calib.rows.observations import Observations


@dataclass(frozen=True)
class ArrayEntry:
    """One array of results.h5.

    Parameters
    ----------
    path
        Group and name, with slashes.
    values
        The array, or texts.
    units
        Unit of the values; one for each column where they differ.
    meaning
        One phrase.
    """

    path: str
    values: FloatArray | Sequence[str]
    units: str | Sequence[str]
    meaning: str


def archive(calibration: Calibration) -> bytes:
    """Return results.h5 of a calibration."""

    def fill(file: h5py.File) -> None:
        file.attrs["format"] = 1
        file.attrs["dataset"] = calibration.name
        file.attrs["dataset_sha256"] = calibration.sha256
        file.attrs["seed"] = calibration.seed
        for entry in entries(calibration):
            texts = not isinstance(entry.values, np.ndarray)
            data = np.array(entry.values, dtype=h5py.string_dtype()) if texts else entry.values
            dataset = file.create_dataset(entry.path, data=data)
            several = not isinstance(entry.units, str)
            dataset.attrs["units"] = list(entry.units) if several else entry.units
            dataset.attrs["meaning"] = entry.meaning

    return hdf5_bytes(fill)


def entries(calibration: Calibration) -> Iterator[ArrayEntry]:
    """Yield all arrays of a calibration."""
    if calibration.gaze is not None:
        yield from _gaze(calibration.gaze)
    if calibration.adjustment is not None:
        yield from _adjustment(calibration.adjustment)


def _gaze(g: GazeResult) -> Iterator[ArrayEntry]:
    yield from _rows("observations", g.rows)
    if g.linear is not None:
        yield ArrayEntry(
            "fits/base/linear/values", g.linear.values, _units(g.linear.names), "estimate"
        )
        yield ArrayEntry("fits/base/linear/residual", g.linear.residual_mrad, "mrad", "of each row")
    if g.convex is not None:
        yield ArrayEntry(
            "fits/base/convex/values", g.convex.values, _units(g.convex.names), "estimate"
        )
        yield ArrayEntry("fits/base/convex/residual", g.convex.residual_mrad, "mrad", "of each row")
    for name, fit in g.robust.items():
        yield from _robust(f"fits/{name}/robust", fit)
    for name, posterior in g.posterior.items():
        yield from _posterior(f"fits/{name}/posterior", posterior)
    for name, told in g.identifiability.items():
        yield from _identifiability(f"identifiability/{name}", told)
    for score in g.comparison.scores if g.comparison is not None else ():
        where = f"comparison/{score.model}"
        meaning = "expected log predictive density of each row"
        yield ArrayEntry(f"{where}/loo_pointwise", score.pointwise, "1", meaning)
        yield ArrayEntry(
            f"{where}/pareto_k", score.pareto_k, "1", "Pareto shape of each row's weights"
        )
    yield from _depths(g)


def _adjustment(a: Adjustment) -> Iterator[ArrayEntry]:
    for model in a.models:
        where, units = f"fits/{model.model}/adjustment", _units(model.names)
        yield ArrayEntry(
            f"{where}/names", model.names, "", "parameters, in the order of the others"
        )
        yield ArrayEntry(f"{where}/values", model.values, units, "estimate")
        yield ArrayEntry(f"{where}/covariance", model.covariance, units, "row by column, products")
        meaning = "standard deviation over that without priors"
        yield ArrayEntry(f"{where}/data_share", model.data_share, "1", meaning)
    record = a.complete
    if record.lens_names:
        lens = _lens_units(record.lens_names)
        yield ArrayEntry(
            "adjustment/lens_names", record.lens_names, "", "intrinsics that were adjusted"
        )
        meaning = "row by column, products of units"
        yield ArrayEntry("adjustment/lens_covariance", record.lens_covariance, lens, meaning)
        meaning = "of the parameters of the complete model, rows, with the intrinsics, columns"
        yield ArrayEntry("adjustment/with_lens", record.with_lens, lens, meaning)
    pose = ("rad",) * 3 + ("mm",) * 3
    yield ArrayEntry("adjustment/pose_12", record.pose_12, pose, "Rodrigues vector and translation")
    yield ArrayEntry("adjustment/pose_covariance", record.pose_covariance, pose, "row by column")
    yield ArrayEntry("adjustment/images", a.images, "", "names of the pictures")
    meaning = "observed minus projected: pictures x corners x coordinates; NaN where left out"
    yield ArrayEntry("adjustment/residuals", a.residuals, "px", meaning)
    yield ArrayEntry("adjustment/readings", a.readings_rad, "rad", "of the encoder")
    meaning = "how much farther C2 stood than each reading says"
    yield ArrayEntry("adjustment/reading_errors", a.reading_errors_rad, "rad", meaning)


def _lens_units(names: Sequence[str]) -> list[str]:
    return ["px" if name[3:] in ("fx", "fy", "cx", "cy") else "1" for name in names]


def _rows(where: str, rows: Observations) -> Iterator[ArrayEntry]:
    yield ArrayEntry(f"{where}/id", rows.ids, "", "name of each row")
    yield ArrayEntry(f"{where}/group", rows.groups, "", "rows that were left out together")
    yield ArrayEntry(f"{where}/x1c", rows.x1c, "1", "normalised, undistorted coordinate in C1")
    yield ArrayEntry(f"{where}/y1c", rows.y1c, "1", "normalised, undistorted coordinate in C1")
    yield ArrayEntry(f"{where}/alpha2", rows.alpha2_rad, "rad", "encoder reading")
    yield ArrayEntry(f"{where}/gaze_residual", rows.gaze_residual_rad, "rad", "from C2's image")
    yield ArrayEntry(f"{where}/z", rows.z_mm, "mm", "reference depth")
    units = ("1", "1", "rad", "rad", "mm")
    meaning = "standard uncertainty of x1c, y1c, alpha2, gaze residual, z: each row's own part"
    yield ArrayEntry(f"{where}/std", rows.std, units, meaning)
    if rows.has_groups:
        meaning = "rows of one number have their reference depth from one measurement"
        yield ArrayEntry(f"{where}/z_group", rows.z_group.astype(float), "1", meaning)
        meaning = "standard uncertainty of that measurement, a part of std of z"
        yield ArrayEntry(f"{where}/u_z_group", rows.u_z_group_mm, "mm", meaning)
    if rows.shared_names:
        meaning = "effect of each shared standard-normal error on x1c, y1c, alpha2, residual, z"
        yield ArrayEntry(f"{where}/shared", rows.shared, units, meaning)
        yield ArrayEntry(f"{where}/shared_source", rows.shared_names, "", "of each shared error")


def _units(names: Sequence[str]) -> list[str]:
    """Return the units of parameters; the logarithm of the noise scale has 1."""
    return [PARAMETERS[INDEX[name]].unit if name in INDEX else "1" for name in names]


def _identifiability(where: str, told: Identifiability) -> Iterator[ArrayEntry]:
    values = np.array([c.singular_value for c in told.combinations])
    directions = np.array([c.direction for c in told.combinations])
    units = _units(told.names)
    yield ArrayEntry(
        f"{where}/names", told.names, "", "parameters, in the order of the other arrays"
    )
    yield ArrayEntry(f"{where}/scale", told.scale, units, "known of any rig beforehand")
    meaning = "of the root of the rows' information, parameters in units of scale"
    yield ArrayEntry(f"{where}/singular_values", values, "1", meaning)
    yield ArrayEntry(f"{where}/directions", directions, "1", "singular directions, one a row")
    yield ArrayEntry(f"{where}/correlation", told.correlation, "1", "with sweep and priors")
    yield ArrayEntry(f"{where}/std_rows", told.rows_std, units, "from the rows alone")
    yield ArrayEntry(f"{where}/std_rows_and_sweep", told.sweep_std, units, "with the yaw sweep")
    yield ArrayEntry(f"{where}/std", told.std, units, "with sweep and priors")


def _robust(where: str, fit: RobustFit) -> Iterator[ArrayEntry]:
    units = _units(fit.names)
    yield ArrayEntry(
        f"{where}/names", fit.names, "", "parameters, in the order of the other arrays"
    )
    yield ArrayEntry(f"{where}/values", fit.values, units, "estimate")
    yield ArrayEntry(
        f"{where}/covariance", fit.covariance, units, "row by column, product of units"
    )
    yield ArrayEntry(f"{where}/residual", fit.residual_mrad, "mrad", "(num / z) - (x1c + cot a)")
    yield ArrayEntry(
        f"{where}/standardised", fit.standardised, "1", "misclosure over stated uncertainty"
    )


def _posterior(where: str, p: Posterior) -> Iterator[ArrayEntry]:
    units = _units(p.names)
    yield ArrayEntry(f"{where}/names", p.names, "", "sampled quantities, last axis of the draws")
    yield ArrayEntry(f"{where}/draws", p.draws, units, "ensembles x thinned draws x quantities")
    yield ArrayEntry(f"{where}/covariance", p.covariance, units, "row by column, product of units")
    yield ArrayEntry(f"{where}/ess_bulk", p.ess_bulk, "1", "effective draws in the bulk")
    yield ArrayEntry(f"{where}/ess_tail", p.ess_tail, "1", "effective draws in the tails")
    yield ArrayEntry(f"{where}/r_hat", p.r_hat, "1", "across independent ensembles")
    yield ArrayEntry(f"{where}/tau", p.tau, "steps", "autocorrelation time")


def _depths(g: GazeResult) -> Iterator[ArrayEntry]:
    tables = []
    if g.depths is not None:
        yield ArrayEntry("depth_uncertainty/z", g.depths.depth_mm, "mm", "true depth of the target")
        tables.append(("depth_uncertainty", g.depths.prediction))
        for name, u in g.depths.sources_mm.items():
            yield ArrayEntry(
                f"depth_uncertainty/sources/{name}", u, "mm", f"part of gum_u by {name}"
            )
    if g.validation is not None:
        yield ArrayEntry("validation/id", g.validation.ids, "", "name of each row")
        yield ArrayEntry("validation/position", g.validation.position_mm, "mm", "x, y, z in C1")
        yield ArrayEntry(
            "validation/reference", g.validation.reference_mm, "mm", "first reference depth"
        )
        tables.append(("validation", g.validation.prediction))
    for where, p in tables:
        yield ArrayEntry(f"{where}/measured", p.z_mm, "mm", "depth at the best estimates")
        yield ArrayEntry(f"{where}/u", p.u_mm, "mm", "standard uncertainty, posterior predictive")
        yield ArrayEntry(f"{where}/low95", p.low95_mm, "mm", "95 % interval")
        yield ArrayEntry(f"{where}/high95", p.high95_mm, "mm", "95 % interval")
        yield ArrayEntry(f"{where}/gum_u", p.gum_u_mm, "mm", "by the linear law of propagation")
