"""Evidence: examples of JCGM 100, 7.2.6 and of ISO 80000-1, B.3; property."""

from __future__ import annotations

from decimal import Decimal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.uncertainty.format import (
    fixed,
    interval,
    last_place,
    percent_down,
    plain,
    significant,
    upwards,
    with_uncertainty,
)


@pytest.mark.parametrize(
    ("value", "u", "expected"),
    [
        (10.057_62, 0.027, ("10.058", "0.027")),  # JCGM 100, 7.2.6
        (2283.623, 54.566, ("2284", "55")),
        (2283.623, 123.4, ("2280", "120")),
        (2285.0, 123.4, ("2280", "120")),  # tie to even
        (0.0133, 0.0005, ("0.01330", "0.00050")),
        (77.09, 0.996, ("77.1", "1.0")),  # the carry moves the place
        (77.09, 99.6, ("80", "100")),
        (0.125, 0.1, ("0.12", "0.10")),
        (2.675, 0.11, ("2.68", "0.11")),  # the tie it looks like, not its binary neighbour
        (-0.3, 12.0, ("0", "12")),  # no negative zero
        (-20.96, 0.85, ("-20.96", "0.85")),
        (1e-9, 1.5e-12, ("0.0000000010000", "0.0000000000015")),
    ],
)
def test_value_and_uncertainty(value: float, u: float, expected: tuple[str, str]) -> None:
    rounded = with_uncertainty(value, u)
    assert (rounded.value, rounded.uncertainty) == expected


def test_ties_of_an_uncertainty_go_up() -> None:
    assert with_uncertainty(1.0, 0.0125).uncertainty == "0.013"
    assert with_uncertainty(1.0, 0.0145).uncertainty == "0.015"


@given(st.floats(1e-9, 1e9), st.floats(-1e9, 1e9))
@settings(max_examples=200, deadline=None)
def test_rounding_never_hides_five_percent(u: float, value: float) -> None:
    rounded = with_uncertainty(value, u)
    shown = Decimal(rounded.uncertainty)
    # The worst case is 10.5 shown as 10: EA-4/02 allows 5 %, and so do we.
    assert shown >= Decimal(repr(u)) * Decimal("0.95")
    place = Decimal(1).scaleb(last_place(u))
    assert shown % place == 0
    assert Decimal(rounded.value) % place == 0
    assert abs(Decimal(rounded.value) - Decimal(repr(value))) <= place / 2
    digits = rounded.uncertainty.replace(".", "").lstrip("0")
    assert len(digits.rstrip("0")) <= 2


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6), st.floats(1e-6, 1e5))
@settings(max_examples=200, deadline=None)
def test_an_interval_is_rounded_outwards(low: float, width: float, u: float) -> None:
    shown = interval(low, low + width, uncertainty=u)
    assert Decimal(shown[0]) <= Decimal(repr(low))
    assert Decimal(shown[1]) >= Decimal(repr(low + width))


def test_known_interval() -> None:
    assert interval(2185.2, 2387.4, uncertainty=54.7) == ("2185", "2388")


@pytest.mark.parametrize("u", [0.0, -1.0, float("nan"), float("inf")])
def test_an_uncertainty_that_decides_no_place_is_refused(u: float) -> None:
    with pytest.raises(ValueError, match="positive and finite"):
        with_uncertainty(1.0, u)


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (67647.37, "67600"),
        (-67647.37, "-67600"),
        (29.6228, "29.6"),
        (0.0123456, "0.0123"),
        (9.996, "10.0"),
        (1.234e-5, "1.23×10⁻⁵"),
        (1234567.0, "1.23×10⁶"),
        (0.0, "0"),
        (float("inf"), "∞"),
    ],
)
def test_significant(number: float, text: str) -> None:
    assert significant(number) == text


def test_fixed_and_per_cent() -> None:
    assert fixed(-30.3605, 1) == "-30.4"
    assert fixed(-0.04, 1) == "0.0"
    assert percent_down(0.99999) == "99.9"
    assert percent_down(1.0) == "100.0"


@pytest.mark.parametrize(
    ("number", "text"),
    [(1.01, "1.1"), (0.92, "0.92"), (0.9201, "0.93"), (9.96, "10"), (231.0, "240")],
)
def test_a_bound_is_rounded_up(number: float, text: str) -> None:
    assert upwards(number) == text


@pytest.mark.parametrize(
    ("number", "text"),
    [(45.0, "45"), (21.3, "21.3"), (485.9, "485.9"), (1e6, "1000000"), (-0.0, "0")],
)
def test_given_numbers_are_not_padded(number: float, text: str) -> None:
    assert plain(number) == text
