"""Calls a stage: a pure function, by name, from frozen inputs to one frozen result."""

from __future__ import annotations

import importlib
import inspect
import typing
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeAlias

from numpy.random import SeedSequence

from calib.core.errors import EstimationError
from calib.stages.stage_file import Failure

Progress: TypeAlias = Callable[[str, int, int], None]
"""Told how far a long stage is: name, steps done, steps expected."""


def call_stage(
    target: str,
    name: str,
    inputs: Sequence[Any],
    settings: Mapping[str, Any],
    progress: Progress,
) -> Any:
    """Return the outcome of a stage: what its function returns, or why it has no answer.

    Parameters
    ----------
    target
        ``module:function``.
    name
        Of the stage. A setting ``seed`` arrives as a SeedSequence that no other name shares.
    inputs, settings
        Passed by position and by keyword.
    progress
        For a function that takes one.
    """
    function, arguments = _function(target), dict(settings)
    if "seed" in arguments:
        arguments["seed"] = SeedSequence(arguments["seed"], spawn_key=tuple(name.encode()))
    if "progress" in inspect.signature(function).parameters:
        arguments["progress"] = partial(progress, name)
    try:
        return function(*inputs, **arguments)
    except EstimationError as error:
        return Failure(str(error))


def result_type(target: str) -> Any:
    """Return the type that a stage returns."""
    return typing.get_type_hints(_function(target))["return"]


def input_types(target: str, count: int) -> list[Any]:
    """Return the types of the first parameters of a stage."""
    function = _function(target)
    hints = typing.get_type_hints(function)
    return [hints[name] for name in list(inspect.signature(function).parameters)[:count]]


def _function(target: str) -> Callable[..., Any]:
    module, name = target.split(":")
    function: Callable[..., Any] = getattr(importlib.import_module(module), name)
    return function
