"""Cosine, sine, logarithm and exponential function, for loops over particles.

Sums and products are compiled to vector instructions. All machines compute the same bits, because
the order of operations is fixed; libraries choose their code by the processor.
"""

from math import factorial, log, pi

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.kernels.compiled import kernel

_QUARTER, _LOG_2_DOUBLE = pi / 2.0, log(2.0)
_ONE, _TWO = np.float32(1.0), np.float32(2.0)
# Coefficients of Taylor series for angles up to an eighth of a turn.
_S3, _S5, _S7, _S9 = (np.float32(c) for c in (-1 / 6, 1 / 120, -1 / 5040, 1 / 362_880))
_C2, _C4, _C6, _C8 = (np.float32(c) for c in (-1 / 2, 1 / 24, -1 / 720, 1 / 40_320))
_L3, _L5, _L7, _L9 = (np.float32(1 / n) for n in (3, 5, 7, 9))
_E2, _E3, _E4, _E5, _E6, _E7, _E8, _E9, _E10, _E11, _E12 = (
    1.0 / factorial(n) for n in range(2, 13)
)
_LOG_2 = np.float32(_LOG_2_DOUBLE)
_BITS_OF_ROOT_HALF, _MANTISSA_BITS = np.int32(0x3F3504F3), np.int32(23)
_SMALLEST = -700.0
"""Number at and below which the exponential is taken as zero."""


@kernel
def cos_sin(angle: float) -> tuple[np.float32, np.float32]:
    """Return cosine and sine of an angle of a few turns [rad], with errors up to 1.2e-7."""
    quarters = np.floor(angle / _QUARTER + 0.5)
    x, quarter = np.float32(angle - quarters * _QUARTER), np.int32(quarters)
    square = x * x
    s = x * (_ONE + square * (_S3 + square * (_S5 + square * (_S7 + square * _S9))))
    c = _ONE + square * (_C2 + square * (_C4 + square * (_C6 + square * _C8)))
    turned_c, turned_s = (s, c) if quarter & 1 else (c, s)
    return (
        -turned_c if (quarter + 1) & 2 else turned_c,
        -turned_s if quarter & 2 else turned_s,
    )


@kernel
def logarithms(values: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """Write natural logarithms of (n,) positive normal numbers into `out`.

    References:
        log((1 + s) / (1 - s)) = 2 (s + s^3 / 3 + s^5 / 5 + ...).
    """
    bits, rest = values.view(np.int32), np.empty(len(values), np.int32)
    for i in range(len(values)):
        exponent = (bits[i] - _BITS_OF_ROOT_HALF) >> _MANTISSA_BITS
        rest[i] = bits[i] - (exponent << _MANTISSA_BITS)
        out[i] = np.float32(exponent) * _LOG_2
    mantissas = rest.view(np.float32)  # from sqrt(1/2) to sqrt(2)
    for i in range(len(values)):
        s = (mantissas[i] - _ONE) / (mantissas[i] + _ONE)
        square = s * s
        series = _ONE + square * (_L3 + square * (_L5 + square * (_L7 + square * _L9)))
        out[i] += _TWO * s * series


@kernel
def exponentials(values: NDArray[np.float64], offset: float, out: NDArray[np.float64]) -> None:
    """Write exp(value - offset) of (n,) values into `out`, with relative errors up to 1e-13.

    `offset` is at least as large as each value. Minus infinity gives zero, NaN gives NaN.
    """
    bits = np.empty(len(values), np.int64)
    for i in range(len(values)):
        x = values[i] - offset
        x = _SMALLEST if x < _SMALLEST else x
        twos = np.floor(x / _LOG_2_DOUBLE + 0.5)
        rest = x - twos * _LOG_2_DOUBLE
        series = _E8 + rest * (_E9 + rest * (_E10 + rest * (_E11 + rest * _E12)))
        series = _E4 + rest * (_E5 + rest * (_E6 + rest * (_E7 + rest * series)))
        out[i] = 1.0 + rest * (1.0 + rest * (_E2 + rest * (_E3 + rest * series)))
        bits[i] = np.int64(np.int32(twos) + 1023) << 52
    powers = bits.view(np.float64)
    for i in range(len(values)):
        out[i] = 0.0 if values[i] - offset <= _SMALLEST else out[i] * powers[i]
