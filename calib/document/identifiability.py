"""calibration.json: what the rows can tell of a model."""

from __future__ import annotations

from pydantic import Field

from calib.document.part import Matrix, Part


class Known(Part):
    """How well a parameter is known, standard deviations; what is infinite is left out."""

    known_beforehand: float = Field(description="of any rig, in the unit of the parameter")
    std_rows: float | None = Field(None, description="from the rows alone")
    std_rows_and_sweep: float | None = Field(None, description="with what the yaw sweep measured")
    std: float | None = Field(None, description="with the priors too")
    decided_by: str = Field(description="rows, sweep, prior, or several of them")


class Combination(Part):
    """A direction in the space of the parameters, in units of what is known beforehand."""

    direction: dict[str, float] = Field(description="unit vector, by parameter")
    singular_value: float = Field(description="of the root of the rows' information")
    std_rows: float | None = Field(None, description="along it, from the rows alone")
    std_rows_and_sweep: float | None = Field(None, description="with what the yaw sweep measured")
    std: float | None = Field(None, description="with the priors too")
    told_by: str = Field(description="rows, sweep or prior: which determines it")
    words: str | None = Field(None, description="what the rows cannot distinguish, and the remedy")


class Identifiability(Part):
    """What the rows can tell of one model."""

    names: tuple[str, ...] = Field(description="free parameters, the order of the correlation")
    parameters: dict[str, Known] = Field(description="how well each is known")
    combinations: tuple[Combination, ...] = Field(description="the best determined first")
    correlation: Matrix = Field(description="of the parameters, with sweep and priors")
    condition: float | None = Field(
        None, description="condition number of the root of the rows' information"
    )
    depth_std_rel: float | None = Field(
        None,
        description="greatest relative standard deviation of depth, from the parameters alone",
    )
