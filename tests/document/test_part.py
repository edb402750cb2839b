"""Parts of calibration.json: what is written is what is read.

Evidence: properties over all numbers; JSON has no text for a number that does not exist.
"""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from calib.document.fits import Fit, Parameter
from calib.document.part import DIGITS, Part, matrix, written

numbers = st.floats(allow_nan=True, allow_infinity=True)


class Sample(Part):
    """A part with all that parts hold."""

    value: float
    may_lack: float | None = None
    by_name: dict[str, float]
    row: tuple[float | None, ...]


@given(numbers, numbers, numbers)
def test_numbers_come_back_to_twelve_digits_and_others_not_at_all(
    a: float, b: float, c: float
) -> None:
    text = json.dumps(written(Sample(value=1.0, may_lack=a, by_name={"b": b}, row=(c, a))))
    found = Sample.model_validate_json(text)
    for stated, read in ((a, found.may_lack), (b, found.by_name.get("b")), (c, found.row[0])):
        if math.isfinite(stated):
            assert read == pytest.approx(stated, rel=10.0 ** (1 - DIGITS), abs=0)
        else:
            assert read is None
    assert len(found.row) == 2


def test_what_is_not_there_is_not_written() -> None:
    found = written(Parameter(value=1.0, std=math.inf, q2_5=0.5))
    assert found == {"value": 1.0, "q2.5": 0.5}


def test_a_key_nobody_knows_is_refused() -> None:
    with pytest.raises(ValidationError):
        Fit.model_validate({"parameters": {}, "names": (), "covariance": (), "extra": 1})


def test_arrays_of_any_size_are_matrices() -> None:
    assert matrix([[1, 2], [3, 4]]) == ((1.0, 2.0), (3.0, 4.0))
    assert matrix([]) == ()


def test_what_numpy_gives_is_written_as_numbers() -> None:
    fit = Fit(
        parameters={},
        names=(),
        covariance=(),
        diagnostics={"array": np.array([1.0, np.nan]), "list": [2.0], "count": np.int64(3)},
    )
    found = written(fit)["diagnostics"]
    assert found == {"array": [1.0, None], "list": [2.0], "count": 3}
