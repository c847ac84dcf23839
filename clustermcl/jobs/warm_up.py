"""Compiles the kernels, or loads their library, before workers are forked."""

import fcntl
import logging
import os
import signal
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
from msgspec.structs import replace

from clustermcl.filter.arrays import OCCUPIED
from clustermcl.filter.grid import Grid
from clustermcl.filter.kernels import library as kernel_library
from clustermcl.filter.kernels.folders import why_untrusted
from clustermcl.filter.laser.ray_casting import cast_rays_from_poses
from clustermcl.filter.laser.seen_cells import codes_of, seen_cells
from clustermcl.filter.laser.sensor_model import computed_model
from clustermcl.filter.settings import (
    BeliefSettings,
    ClusterSettings,
    FilterSettings,
    MotionSettings,
    SearchSettings,
    SensorSettings,
)
from clustermcl.jobs.in_process import InProcess
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.steps import Landmark, PositionField, Scan, Seen
from clustermcl.runtime.folders import log_remarks
from clustermcl.runtime.parent import PARENT_VARIABLE
from clustermcl.runtime.stop import StoppedError

_TAG = Landmark(name="tag", x=1.0, y=1.0, sigma=0.1)
_SEEN = Seen(
    landmark="tag",
    mean=(1.0, 0.0),
    covariance=(0.01, 0.0, 0.0, 0.01),
    outlier_probability=0.05,
    share=1.0,
)
_REGION = replace(
    _SEEN,
    landmark="",
    field=PositionField(cell_m=1.0, log_likelihoods=ArrayBlob.of(np.zeros((4, 4)), "float32")),
)

_log = logging.getLogger(__name__)


def compile_kernels(sensor: SensorSettings) -> None:
    """Build the library of kernels if it is not on disk.

    Where it cannot be built, numba compiles them at each start rather than at the first scan.

    Raises:
        NoKernelsError: there is no library, and no numba that compiles one.
        StoppedError: a signal ended the compilation; Ctrl-C reaches all processes of a terminal.
    """
    is_built = kernel_library.library() is not None
    log_remarks()
    if is_built or os.environ.get("NUMBA_DISABLE_JIT") == "1":
        return
    if find_spec("numba") is None:
        raise kernel_library.NoKernelsError
    _log.info("compiling the kernels for this machine: some 20 s, only at the first start")
    try:
        _build_library()
        return
    except OSError as error:
        reason = str(error)
    except subprocess.CalledProcessError as error:
        reason = (error.stderr.strip().splitlines() or [str(error)])[-1]
        # Python that is interrupted while it starts exits with 1.
        interrupted = error.returncode in (-signal.SIGINT, -signal.SIGTERM)
        if interrupted or reason == "KeyboardInterrupt":
            raise StoppedError from None
    _log.warning(
        "no library of kernels can be built, so each process takes 100 MB and some 20 s more: %s",
        reason,
    )
    run_kernels(sensor, MotionSettings())


def _build_library() -> None:
    """Build it, unless another process has built it meanwhile."""
    file = kernel_library.path()
    file.parent.mkdir(parents=True, exist_ok=True)
    if problem := why_untrusted(file.parent):
        raise PermissionError(problem)
    with (file.parent / "kernels.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        kernel_library.library.cache_clear()
        if kernel_library.library() is None:
            command = [sys.executable, "-I", "-m", "clustermcl.jobs.build_kernels", str(file)]
            environment = {**os.environ, PARENT_VARIABLE: str(os.getpid())}
            subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
    kernel_library.library.cache_clear()


def run_kernels(sensor: SensorSettings, motion: MotionSettings) -> None:
    """Run every kernel once with these models: search, track, see a tag, cast rays."""
    rng, sensor = np.random.default_rng(0), replace(sensor, max_beams=6)
    small = FilterSettings(
        sensor=sensor,
        motion=motion,
        cluster=ClusterSettings(particles=100),
        search=SearchSettings(heading_step_rad=0.2, poses=200, shards=1, max_steps=3),
        belief=BeliefSettings(elsewhere_poses=100),
    )
    cells = np.zeros((40, 40), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = OCCUPIED
    model = computed_model(Grid(cells, 0.1, np.zeros(3)), sensor)
    process = InProcess(model, small)
    for step in range(5):
        process.advance(_scan(step, rng))
    angles = np.zeros(1)
    cast_rays_from_poses(model.jumps, model.grid, np.ones((1, 3)), angles, 1.0)  # advice
    seen, out, ranges = np.zeros(cells.shape, np.int32), np.zeros((9, 2), np.int32), np.ones(1)
    pose, codes = np.zeros(3), codes_of(cells)
    beams = ranges, 0.0, 0.1, 9.0
    seen_cells(codes, seen, 1, model.grid.in_cells, pose, *beams, 9.0, 3.0, out)  # changes


def _scan(step: int, rng: np.random.Generator) -> Scan:
    return Scan(
        sender="warm-up",
        step=step,
        stamp_ns=step,
        odom_from_robot=(0.3 * step, 0.0, 0.1 * step),
        robot_from_laser=(0.0, 0.0, 0.0),
        angle_min_rad=-1.5,
        angle_step_rad=0.05,
        range_max_m=10.0,
        ranges=ArrayBlob.of(rng.uniform(1.0, 2.0, 60), "float32"),
        map_digest="",
        observations=(_SEEN, _REGION),
        landmarks=(_TAG,),
    )
