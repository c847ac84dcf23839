"""`clustermcl warm-up`: compute what later starts read from disk."""

import time

from clustermcl.commands.kernels import prepare_kernels
from clustermcl.commands.options import settings_command
from clustermcl.commands.verbosity import say
from clustermcl.filter.kernels import library as kernel_library
from clustermcl.jobs.map_model import sensor_model
from clustermcl.recordings.maps.map_file import load_map_with_obstacles, map_file_of
from clustermcl.runtime.folders import kept_folder
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.sources import is_published


@settings_command()
def warm_up(settings: Settings) -> None:
    """Prepare this machine, so that later starts take seconds.

    Compiles the filter's kernels, and computes the likelihood field of bridge.map. Both are kept
    on disk.
    """
    begun_s = time.monotonic()
    prepare_kernels(settings.sensor)
    if kernel_library.library() is not None:
        say(f"all kernels are on disk, after {time.monotonic() - begun_s:.1f} s")
    bridge = settings.bridge
    file = map_file_of(bridge.map, bridge.source)
    if not file or is_published(file, bridge.source):
        return
    grid_map, begun_s = load_map_with_obstacles(file), time.monotonic()
    sensor_model(grid_map, settings.sensor, kept_folder("maps", settings.worker.cache_folder))
    say(f"the likelihood field of {file} is ready after {time.monotonic() - begun_s:.1f} s")
