"""Localization that knows when it is not sure: the library, the client, and the command.

`ClusterMCL` localizes in the caller's process; `Client` queries a running system. Names are
imported when first used, so that ``import clustermcl`` is fast.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clustermcl.client import Client as Client
    from clustermcl.client import NotLocalizedError as NotLocalizedError
    from clustermcl.localizer import Belief as Belief
    from clustermcl.localizer import ClusterMCL as ClusterMCL
    from clustermcl.readings import Reading as Reading
    from clustermcl.readings import read_recording as read_recording
    from particle_filter.extensions import register as register
    from process_runtime.output_files import OutputError as OutputError
    from protocol.answers import Hypothesis as Hypothesis
    from protocol.errors import ClusterMclError as ClusterMclError
    from protocol.errors import CommandRefusedError as CommandRefusedError
    from protocol.errors import MalformedMessageError as MalformedMessageError
    from protocol.errors import MapFileError as MapFileError
    from protocol.errors import RecordingError as RecordingError
    from protocol.errors import SettingsError as SettingsError
    from protocol.errors import StateFileError as StateFileError
    from protocol.errors import UnreachableError as UnreachableError
    from recordings.map_file import load_map_with_obstacles as load_map  # noqa: F401 - public

_WHERE = {
    "Belief": "clustermcl.localizer",
    "Client": "clustermcl.client",
    "ClusterMCL": "clustermcl.localizer",
    "ClusterMclError": "protocol.errors",
    "CommandRefusedError": "protocol.errors",
    "Hypothesis": "protocol.answers",
    "MalformedMessageError": "protocol.errors",
    "MapFileError": "protocol.errors",
    "NotLocalizedError": "clustermcl.client",
    "OutputError": "process_runtime.output_files",
    "Reading": "clustermcl.readings",
    "RecordingError": "protocol.errors",
    "SettingsError": "protocol.errors",
    "StateFileError": "protocol.errors",
    "UnreachableError": "protocol.errors",
    "load_map": "recordings.map_file",
    "read_recording": "clustermcl.readings",
    "register": "particle_filter.extensions",
}
__all__ = [*_WHERE]  # noqa: PLE0604 - names


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    inside = "load_map_with_obstacles" if name == "load_map" else name
    found = getattr(import_module(_WHERE[name]), inside)
    globals()[name] = found
    return found
