"""Calls a stage: a pure function from frozen inputs to one frozen result."""

from __future__ import annotations

import importlib
import inspect
import typing
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeAlias, TypeVar

from numpy.random import SeedSequence

from calib.core.errors import EstimationError
from calib.stages.stage_file import Failure

T = TypeVar("T")

Progress: TypeAlias = Callable[[str, int, int], None]
"""Told how far a long stage is: name, steps done, steps expected."""


def call_stage(
    function: Callable[..., T],
    name: str,
    inputs: Sequence[Any],
    settings: Mapping[str, Any],
    progress: Progress,
) -> T | Failure:
    """Return the outcome of a stage: what its function returns, or why it has no answer.

    Parameters
    ----------
    function
        The stage.
    name
        Its name. A setting ``seed`` arrives as a SeedSequence that no other name shares.
    inputs, settings
        Passed by position and by keyword.
    progress
        For a function that takes one.
    """
    arguments = dict(settings)
    if "seed" in arguments:
        arguments["seed"] = SeedSequence(arguments["seed"], spawn_key=tuple(name.encode()))
    if "progress" in inspect.signature(function).parameters:
        arguments["progress"] = partial(progress, name)
    try:
        return function(*inputs, **arguments)
    except EstimationError as error:
        return Failure(str(error))


def result_type(function: Callable[..., Any]) -> Any:
    """Return the type that a stage returns."""
    return typing.get_type_hints(function)["return"]


def input_types(function: Callable[..., Any], count: int) -> list[Any]:
    """Return the types of the first parameters of a stage."""
    hints = typing.get_type_hints(function)
    return [hints[name] for name in list(inspect.signature(function).parameters)[:count]]


def address(function: Callable[..., Any]) -> str:
    """Return ``module:function``, by which another process finds a stage."""
    return f"{function.__module__}:{function.__qualname__}"


def function_at(address: str) -> Callable[..., Any]:
    """Return the stage at an address, its module imported."""
    module, name = address.split(":")
    function: Callable[..., Any] = getattr(importlib.import_module(module), name)
    return function
