"""What the report prints beside the results: whence the data, what was assumed, by whom."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from calib.dataset.contents import Dataset
from calib.dataset.depth_origin import ahead_of_c1
from calib.dataset.manifest import DEFAULT_U_X1C, GazeSection, Manifest, ValidationSection
from calib.dataset.tables import GazeTable
from calib.geometry.parameters import REFERENCE_OFFSET
from calib.stages.provenance import Provenance
from calib.uncertainty.format import significant


@dataclass(frozen=True)
class Statement:
    """Something that the calibration takes as given.

    Parameters
    ----------
    what
        The quantity.
    value
        With its unit.
    source
        Who says so.
    """

    what: str
    value: str
    source: str


@dataclass(frozen=True)
class ReportContext:
    """All that the report prints and that is no result.

    Parameters
    ----------
    source
        Label and text: citation, DOI, address, licence, notes.
    reference, validation_reference
        What the reference depths are; None without such rows.
    statements
        Stated uncertainties and what else was taken as given.
    encoder_step_rad
        One count or microstep; None where no encoder is described.
    priors
        Mean and standard deviation by parameter, as the manifest states them.
    scaled_priors
        Default ones that were scaled to a rig of another size.
    published
        Published value and standard uncertainty by quantity, as the manifest states them.
    made
        Versions, commit, command, times.
    """

    source: tuple[tuple[str, str], ...]
    reference: str | None
    validation_reference: str | None
    statements: tuple[Statement, ...]
    encoder_step_rad: float | None
    priors: Mapping[str, tuple[float, float]]
    published: Mapping[str, tuple[float, float]]
    made: Provenance
    scaled_priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def report_context(dataset: Dataset, made: Provenance) -> ReportContext:
    """Return what the report prints of a dataset and of the run."""
    m = dataset.manifest
    return ReportContext(
        source=_source(m),
        reference=m.gaze.reference if m.gaze is not None else None,
        validation_reference=m.validation.reference if m.validation is not None else None,
        statements=tuple(_statements(dataset)),
        encoder_step_rad=None if m.encoder is None else _rad(m.encoder.resolution_deg),
        priors=_priors(m),
        published={name: (known.mean, known.std) for name, known in m.published.items()},
        made=made,
    )


def _priors(m: Manifest) -> dict[str, tuple[float, float]]:
    """Return the priors that the manifest states, that of where z_mm counts from among them."""
    priors = {name: (prior.mean, prior.std) for name, prior in m.priors.items()}
    u_origin = 0.0 if m.gaze is None else ahead_of_c1(m.gaze.origin)[1]
    return priors | ({REFERENCE_OFFSET: (0.0, u_origin)} if u_origin > 0 else {})


def _rad(degrees: float) -> float:
    return float(np.deg2rad(degrees))


def _source(m: Manifest) -> tuple[tuple[str, str], ...]:
    s = m.source
    named: Mapping[str, str | None] = {
        "Citation": s.citation,
        "DOI": s.doi,
        "Address": s.url,
        "Licence": s.license,
        "Notes": s.notes,
    }
    return tuple((label, text) for label, text in named.items() if text)


IN_MANIFEST = "dataset.toml"
BY_DEFAULT = "default, as dataset.toml says nothing"
BY_READS = "default for what is read, as dataset.toml states no u_alpha2_deg"
IN_ROWS = "row by row, in the table"


def _statements(dataset: Dataset) -> list[Statement]:
    m, found = dataset.manifest, []
    if m.encoder is not None:
        e = m.encoder
        found.append(
            Statement("one count or step of the yaw encoder", f"{e.resolution_deg:g}°", IN_MANIFEST)
        )
        if e.reads is not None:
            found.append(Statement("what a reading is", e.reads, IN_MANIFEST))
        if e.further_u_deg:
            source = BY_READS if e.u_alpha2_deg is None else IN_MANIFEST
            found.append(Statement("further u(α2) of a reading", f"{e.further_u_deg:.3g}°", source))
    if m.gaze is not None and dataset.gaze is not None:
        if any(dataset.gaze.image_c1):
            found.append(Statement("x1c, y1c of a row", "with its covariance", "pictures of C1"))
        if np.isfinite(dataset.gaze.x1c).any():
            stated = m.gaze.u_x1c != DEFAULT_U_X1C
            found.append(
                Statement(
                    "u(x1c) of a row", f"{m.gaze.u_x1c:g}", IN_MANIFEST if stated else BY_DEFAULT
                )
            )
        found.append(_depth("calibration", dataset.gaze, m.gaze.u_z_mm, m.gaze.u_z_rel))
        found += _group("calibration", m.gaze)
    if m.validation is not None and dataset.validation is not None:
        u_z_mm, u_z_rel = m.validation.u_z_mm, m.validation.u_z_rel
        found.append(_depth("validation", dataset.validation, u_z_mm, u_z_rel))
        found += _group("validation", m.validation)
    return found


def _depth(kind: str, rows: GazeTable, u_mm: float, u_rel: float) -> Statement:
    """Return the statement on the uncertainty of reference depths."""
    what = f"u(z) of a {kind} row's reference"
    if any(rows.stereo):
        return Statement(what, "with its covariance", "stereo pairs")
    if np.isfinite(rows.u_z_mm).any():
        return Statement(what, "each its own", IN_ROWS)
    return Statement(what, _size(u_mm, u_rel) or "none stated: taken as exact", IN_MANIFEST)


def _group(kind: str, section: GazeSection | ValidationSection) -> list[Statement]:
    """Return the statement on what references of one group have in common, if there is one."""
    size = _size(section.u_z_group_mm, section.u_z_group_rel)
    what = f"u(z) that {kind} rows of one group have in common"
    return [Statement(what, size, IN_MANIFEST)] if size else []


def _size(u_mm: float, u_rel: float) -> str:
    """Return an uncertainty of depth in words; nothing for none."""
    parts = [f"{u_mm:g} mm"] if u_mm else []
    parts += [f"{significant(100 * u_rel, digits=2)} % of z"] if u_rel else []
    return " and ".join(parts)
