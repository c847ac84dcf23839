"""Localization that knows when it is not sure: the library, the client, and the command.

`ClusterMCL` localizes in the caller's process; `Client` queries and controls a running system.
Names are imported when they are first used, so that ``import clustermcl`` is fast.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from clustermcl.runtime.version import VERSION

if TYPE_CHECKING:
    from clustermcl.client import Client as Client
    from clustermcl.client import NotLocalizedError as NotLocalizedError
    from clustermcl.localizer import Belief as Belief
    from clustermcl.localizer import ClusterMCL as ClusterMCL
    from clustermcl.protocol.answers import Hypothesis as Hypothesis
    from clustermcl.protocol.errors import ClusterMclError as ClusterMclError
    from clustermcl.protocol.errors import CommandRefusedError as CommandRefusedError
    from clustermcl.protocol.errors import LandmarksFileError as LandmarksFileError
    from clustermcl.protocol.errors import MalformedMessageError as MalformedMessageError
    from clustermcl.protocol.errors import MapFileError as MapFileError
    from clustermcl.protocol.errors import RecordingError as RecordingError
    from clustermcl.protocol.errors import SettingsError as SettingsError
    from clustermcl.protocol.errors import UnreachableError as UnreachableError
    from clustermcl.readings import Reading as Reading
    from clustermcl.readings import read_recording as read_recording
    from clustermcl.recordings.maps.grid_map import GridMap as GridMap
    from clustermcl.recordings.maps.landmarks import load_landmarks as load_landmarks
    from clustermcl.recordings.maps.map_file import load_map_with_obstacles
    from clustermcl.runtime.output_files import OutputError as OutputError
    from clustermcl.simulated_robot import SimulatedRobot as SimulatedRobot

    load_map = load_map_with_obstacles

_NAMES = {
    "clustermcl.client": ("Client", "NotLocalizedError"),
    "clustermcl.localizer": ("Belief", "ClusterMCL"),
    "clustermcl.readings": ("Reading", "read_recording"),
    "clustermcl.simulated_robot": ("SimulatedRobot",),
    "clustermcl.recordings.maps.grid_map": ("GridMap",),
    "clustermcl.recordings.maps.landmarks": ("load_landmarks",),
    "clustermcl.runtime.output_files": ("OutputError",),
    "clustermcl.protocol.answers": ("Hypothesis",),
    "clustermcl.protocol.errors": (
        "ClusterMclError", "CommandRefusedError", "LandmarksFileError", "MalformedMessageError",
        "MapFileError", "RecordingError", "SettingsError", "UnreachableError",
    ),
    "clustermcl.recordings.maps.map_file": ("load_map",),
}  # fmt: skip
__version__ = VERSION
_MODULES = {name: module for module, names in _NAMES.items() for name in names}
__all__ = sorted(_MODULES)  # noqa: PLE0605 - names


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    inside = "load_map_with_obstacles" if name == "load_map" else name
    found = globals()[name] = getattr(import_module(_MODULES[name]), inside)
    return found
