"""`clustermcl warm-up`: compute what later starts read from disk."""

import os
import time
from pathlib import Path

from clustermcl.verbosity import say
from particle_filter import kernel_library, kernels
from process_runtime.folders import kept_folder
from process_runtime.output_files import OutputError
from process_runtime.settings import Settings
from process_runtime.sources import is_published
from recordings.map_file import load_map_with_obstacles, map_file_of
from worker.map_model import sensor_model
from worker.warm_up import compile_kernels


def run_warm_up(settings: Settings) -> None:
    """Compile the kernels, and compute the likelihood field of `bridge.map` if it is a file."""
    begun_s = time.monotonic()
    if kernel_library.library() is None:
        say("compiling the kernels, some 20 s")
    compile_kernels(settings.sensor)
    if kernels.cache_problems:
        folder = Path(os.environ.get("NUMBA_CACHE_DIR", "the folder of compiled kernels"))
        raise OutputError(path=folder, problem=kernels.cache_problems[0])
    say(f"all kernels are on disk, after {time.monotonic() - begun_s:.1f} s")
    bridge = settings.bridge
    file = map_file_of(bridge.map, bridge.source)
    if not file or is_published(file, bridge.source, ros2=settings.ros2.enabled):
        return
    grid_map, begun_s = load_map_with_obstacles(file), time.monotonic()
    sensor_model(grid_map, settings.sensor, kept_folder("maps", settings.worker.cache_folder))
    say(f"the likelihood field of {file} is ready after {time.monotonic() - begun_s:.1f} s")
