"""The section [virtual] of rig.toml: which rig is simulated and what is wrong with it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final, Literal

from pydantic import ConfigDict, Field, model_validator

from calib.dataset.fields import Line, NotNegative, Number, Positive, refuse
from calib.dataset.messages import shown, suggestion
from calib.dataset.section import Section
from calib.geometry.parameters import NAMES

Share = Annotated[Number, Field(ge=0, le=1)]
Seed = Annotated[int, Field(strict=True, ge=0)]
Frames = Annotated[int, Field(strict=True, ge=0, le=100)]
Milliseconds = Annotated[NotNegative, Field(le=100_000)]
Period = Annotated[Number, Field(ge=1, le=100_000)]
Steps = Annotated[NotNegative, Field(le=10_000)]
Grey = Annotated[NotNegative, Field(le=255)]

PARAMETER_MOST: Final = 1e5
"""No virtual rig is larger than 100 m: places that its cameras see would be looked for for ever."""


class Faults(Section):
    """What is wrong with the devices; all off unless named.

    Parameters
    ----------
    latency_frames
        A frame arrives so many frame periods late, drawn anew for each between 0 and this.
    clock_offset_s, clock_drift_ppm
        Of the cameras' clocks against the host's.
    dropped_share, torn_share
        Frames that never arrive, and those of which the lower part is of an earlier one.
    stale
        The camera's driver lies: it hands out the newest frame there is, whenever it was exposed.
    backlash_steps
        Play between motor and C2, in motor steps.
    microstep_error
        Amplitude of the error that repeats every full step, as a share of a full step.
    lost_steps_share
        Moves in which the motor loses steps.
    stopped_share
        Moves that another hand stops on the way.
    early_done_ms
        The controller says so long before rest that the move is done.
    ringing_ms
        C2 rings on after a move, by a step at first, dying away with this time constant.
    truncated
        The controller cuts a command down to 1/256 of a full step instead of rounding it.
    reversed
        The encoder counts the other way.
    moving_share
        Gazes during which the target is moved.
    drift_deg_h
        The zero of the readings wanders by so much in an hour, as a mount that warms up lets it.
    """

    latency_frames: Frames = 0
    clock_offset_s: Annotated[Number, Field(ge=-1e9, le=1e9)] = 0.0
    clock_drift_ppm: Annotated[Number, Field(ge=-1e4, le=1e4)] = 0.0
    dropped_share: Share = 0.0
    torn_share: Share = 0.0
    stale: bool = False
    backlash_steps: Steps = 0.0
    microstep_error: Annotated[Number, Field(ge=0, le=0.25)] = 0.0
    lost_steps_share: Share = 0.0
    stopped_share: Share = 0.0
    early_done_ms: Milliseconds = 0.0
    ringing_ms: Milliseconds = 0.0
    truncated: bool = False
    reversed: bool = False
    moving_share: Share = 0.0
    drift_deg_h: Annotated[Number, Field(ge=-3600, le=3600)] = 0.0


class VirtualSettings(Faults):
    """The rig that is simulated. Further keys are parameters of the model, with their values.

    Parameters
    ----------
    seed
        Everything random follows from it.
    model
        Model of `calib.geometry.parameters.MODELS` that the rig is drawn from.
    time
        "real" passes as it does; "simulated" time passes when the devices are waited for.
    exposure_ms, frame_ms
        Of the cameras.
    encoder_noise_deg
        Standard deviation of what an encoder reads, on top of its resolution.
    target
        What stands before the rig: "board", "tag:DICTIONARY:ID", "cross" or "blob".
    light
        Brightness of the scene; 1 makes white paper 210 of 255.
    grey_noise
        Standard deviation of the grey values, 8-bit steps.
    truth
        File to which the truth is written as it comes to pass, one JSON object a line.
    """

    model_config = ConfigDict(frozen=True, extra="allow")

    seed: Seed = 1
    model: Literal["base", "axis-offset"] = "axis-offset"
    time: Literal["real", "simulated"] = "real"
    exposure_ms: Annotated[Positive, Field(le=100_000)] = 8.0
    frame_ms: Period = 40.0
    encoder_noise_deg: Annotated[NotNegative, Field(le=90)] = 0.0
    target: Line = "board"
    light: Annotated[Positive, Field(le=1000)] = 1.0
    grey_noise: Grey = 1.5
    truth: Line | None = None

    @property
    def parameters(self) -> Mapping[str, float]:
        """Parameters of the rig set to a value instead of drawn, by name."""
        return {name: float(value) for name, value in (self.model_extra or {}).items()}

    @model_validator(mode="after")
    def _check_parameters(self) -> VirtualSettings:
        for name, value in (self.model_extra or {}).items():
            if name not in NAMES:
                refuse(
                    f"unknown key {shown(name)}",
                    suggestion(name, [*VirtualSettings.model_fields, *NAMES]),
                )
            if isinstance(value, bool) or not isinstance(value, int | float) or value - value != 0:
                refuse(f"{name} = {shown(value)} is not a finite number", "write a number")
            if abs(value) > PARAMETER_MOST:
                refuse(
                    f"{name} = {value:g} is out of range",
                    f"give at most {PARAMETER_MOST:g}, in mm or rad",
                )
        return self
