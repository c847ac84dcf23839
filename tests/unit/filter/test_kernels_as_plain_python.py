"""What holds for whole processes: kernels without the compiler, modules without its cost."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.beam_fits import beam_fits
from clustermcl.filter.laser.likelihood_field import LikelihoodField, scan_log_likelihood
from clustermcl.filter.laser.sensor_model import ground_log_penalty
from clustermcl.filter.motion.model import move, standard_normals
from clustermcl.filter.resampling import resample
from clustermcl.filter.search.places import cluster_by_source_point
from clustermcl.filter.settings import MotionSettings, SensorSettings
from tests.unit.filter.rooms import model_of, plain_room, seen_from

REPOSITORY = Path(__file__).parents[3]


def results() -> dict[str, NDArray[Any]]:
    """A little of everything that is compiled."""
    rng = np.random.default_rng(6)
    cells = (rng.random((30, 40)) < 0.1).astype(np.int8)
    poses, hits = rng.uniform(0, 3, (70, 3)), rng.uniform(-2, 2, (10, 2))
    field = LikelihoodField.build(Grid(cells, 0.1, np.array([0.1, 0.2, 0.3])), SensorSettings())
    log_likelihood = scan_log_likelihood(poses, hits, field)
    after, differential = np.array([0.3, 0.1, 0.2]), MotionSettings(model="differential")
    return {
        "log_likelihood": log_likelihood,
        "penalty": ground_log_penalty(poses, field.grid, -1.0),
        "omnidirectional": move(poses, after, MotionSettings(), standard_normals(rng, 3, 70)),
        "differential": move(poses, after, differential, standard_normals(rng, 3, 70)),
        "drawn": resample(log_likelihood, 70, rng),
        "beams": np.frombuffer(
            beam_fits(
                np.array([5.0, 2.0, 0.0]),
                seen_from(np.array([1.0, 3.0, 0.3]), plain_room()),
                model_of(plain_room()),
                mirrored=False,
            ),
            np.uint8,
        ),
        "labels": cluster_by_source_point(poses, log_likelihood, 0.5, 0.5, 100)[0],
    }


def run(code: str, **environment: str) -> None:
    subprocess.run(
        [sys.executable, "-c", code], check=True, cwd=REPOSITORY, env={**os.environ, **environment}
    )


def test_plain_python_computes_what_the_kernels_compute(tmp_path: Path) -> None:
    stored = tmp_path / "plain.npz"
    module = "tests.unit.filter.test_kernels_as_plain_python"
    run(
        f"import numpy, {module} as m; numpy.savez({str(stored)!r}, **m.results())",
        NUMBA_DISABLE_JIT="1",
        PYTHONWARNINGS="error",  # bytes must not wrap around without the compiler's integers
    )
    plain = np.load(stored)
    for name, compiled in results().items():
        # The compiler may fuse a multiplication and an addition: a last digit can differ.
        np.testing.assert_allclose(compiled, plain[name], rtol=1e-12, atol=1e-12, err_msg=name)
