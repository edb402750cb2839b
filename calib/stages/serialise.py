"""Frozen dataclasses to plain documents and arrays, and back with every type checked."""

from __future__ import annotations

from typing import Any, TypeVar, get_args

import cattrs
import numpy as np
from cattrs.strategies import configure_union_passthrough

T = TypeVar("T")

ARRAY = "array"


def serialise(value: object) -> tuple[Any, dict[str, np.ndarray[Any, Any]]]:
    """Return a JSON-able document of a dataclass, and its arrays by the keys it refers to.

    Understands bool, int, float, str, None, tuples, mappings with text keys, numpy arrays and
    dataclasses of these.
    """
    arrays: dict[str, np.ndarray[Any, Any]] = {}

    def keep(array: np.ndarray[Any, Any]) -> dict[str, str]:
        key = f"array{len(arrays):04d}"
        arrays[key] = array
        return {ARRAY: key}

    converter = cattrs.Converter()
    converter.register_unstructure_hook(np.ndarray, keep)
    converter.register_unstructure_hook_func(_is_array, keep)
    return converter.unstructure(value), arrays


def deserialise(document: Any, arrays: dict[str, np.ndarray[Any, Any]], kind: type[T]) -> T:
    """Return the dataclass of type `kind` that `take_apart` took apart.

    Raises
    ------
    TypeError, ValueError, KeyError
        If the document does not fit the type.
    """

    def fetch(reference: Any, wanted: Any) -> np.ndarray[Any, Any]:
        array = arrays[reference[ARRAY]]
        _, dtype = get_args(wanted)
        (scalar,) = get_args(dtype)
        if array.dtype != np.dtype(scalar):
            raise TypeError(f"an array of {array.dtype} stands where {scalar.__name__} belongs")
        return array

    def exact(value: Any, wanted: type) -> Any:
        # JSON has one kind of number; a whole float may come back as int, nothing else may change.
        if wanted is float and type(value) is int:
            return float(value)
        if type(value) is not wanted:
            raise TypeError(f"{value!r} stands where {wanted.__name__} belongs")
        return value

    def sequence(value: Any, wanted: Any) -> tuple[Any, ...]:
        # Of a text cattrs would make a tuple of its letters.
        if type(value) is not list:
            raise TypeError(f"{value!r} stands where a list belongs")
        kinds = get_args(wanted)
        if kinds[-1] is Ellipsis:
            kinds = kinds[:1] * len(value)
        return tuple(converter.structure(v, k) for v, k in zip(value, kinds, strict=True))

    converter = cattrs.Converter(forbid_extra_keys=True, detailed_validation=False)
    converter.register_structure_hook_func(_is_tuple, sequence)
    converter.register_structure_hook_func(_is_array, fetch)
    for scalar in (bool, int, float, str):
        converter.register_structure_hook(scalar, exact)
    configure_union_passthrough(str | bool | int | float | None, converter)
    return converter.structure(document, kind)


def _is_array(kind: Any) -> bool:
    return getattr(kind, "__origin__", None) is np.ndarray


def _is_tuple(kind: Any) -> bool:
    return getattr(kind, "__origin__", None) is tuple
