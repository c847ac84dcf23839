import subprocess
import sys

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from particle_filter.sums import weighted_sum

SUMS = """
import numpy as np
from particle_filter.gaussian import fit_gaussian
from particle_filter.log_weights import effective_sample_size
rng = np.random.default_rng(1)
poses, log_weights = rng.normal(size=(60_000, 3)), rng.normal(size=60_000)
mean, covariance = fit_gaussian(poses, np.exp(log_weights))
size = effective_sample_size(log_weights)
print([value.hex() for value in (*mean.tolist(), *covariance.ravel().tolist(), size)])
"""


@given(
    arrays(np.float64, (20,), elements=st.floats(-50, 50)),
    arrays(np.float64, (20,), elements=st.floats(0, 1)),
)
def test_sums_are_those_of_the_textbook(values: np.ndarray, weights: np.ndarray) -> None:
    expected = sum(a * w for a, w in zip(values, weights, strict=True))
    np.testing.assert_allclose(weighted_sum(values, weights), expected, atol=1e-9)


def test_estimates_are_the_same_to_the_last_bit_however_many_threads_blas_has() -> None:
    """Workers have one, programs of others as many as there are cores."""
    said = {
        subprocess.run(
            [sys.executable, "-I", "-c", SUMS],
            env={"OPENBLAS_NUM_THREADS": threads},
            capture_output=True, text=True, check=True, timeout=60,
        ).stdout
        for threads in ("1", "2", "4")
    }  # fmt: skip
    assert len(said) == 1
