import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from clustermcl.filter.kernels.elementary_functions import cos_sin, exponentials, logarithms


@given(st.floats(-20.0, 20.0))
def test_cosine_and_sine_are_right_to_single_precision(angle: float) -> None:
    """The library's, rounded, are up to 6e-8 off themselves."""
    assert cos_sin(angle) == pytest.approx((math.cos(angle), math.sin(angle)), abs=1.3e-7)


def test_logarithms_are_right_to_single_precision() -> None:
    """Over all that a uniform number of 32 bits can be, its ends included."""
    exponents = np.repeat(np.arange(-33, 1), 200)
    mantissas = np.tile(np.linspace(0.5, 1.0, 200), 34)
    values = np.ldexp(mantissas, exponents).astype(np.float32)
    found = np.empty_like(values)
    logarithms(values, found)
    expected = np.log(values.astype(np.float64))
    np.testing.assert_allclose(found, expected, rtol=2.5e-7, atol=1e-7)


def test_logarithms_are_numpys_sums_in_single_precision_to_the_last_bit() -> None:
    """So every machine finds the same, whatever vectors it computes in."""
    one, two, log_2 = np.float32(1.0), np.float32(2.0), np.float32(math.log(2.0))
    third, fifth, seventh, ninth = (np.float32(1 / n) for n in (3, 5, 7, 9))
    mantissas = np.linspace(0.71, 1.41, 1000, dtype=np.float32)
    exponents = np.arange(1000, dtype=np.float32) % 32 - 31
    values = mantissas * two**exponents
    found = np.empty_like(values)
    logarithms(values, found)
    s = (mantissas - one) / (mantissas + one)
    square = s * s
    series = one + square * (third + square * (fifth + square * (seventh + square * ninth)))
    np.testing.assert_array_equal(found, exponents * log_2 + two * s * series)


def exp(values: NDArray[np.float64], offset: float) -> NDArray[np.float64]:
    found = np.empty_like(values)
    exponentials(values, offset, found)
    return found


@given(st.floats(-690.0, 0.0), st.floats(-1e3, 1e3))
def test_exponentials_are_right_to_13_digits(value: float, offset: float) -> None:
    assert exp(np.array([value + offset]), offset)[0] == pytest.approx(
        math.exp(value + offset - offset), rel=1e-13
    )


def test_exponentials_of_infinite_nan_and_tiny_values() -> None:
    found = exp(np.array([0.0, -math.inf, -1e300, -700.0, math.nan]), 0.0)
    np.testing.assert_array_equal(found, [1.0, 0.0, 0.0, 0.0, math.nan])
