"""Loads maps: from ROS map_server YAML, run logs, ROS bags, and buildings of these."""

import logging
from collections import deque
from contextlib import closing
from pathlib import Path

import numpy as np

from clustermcl.filter.arrays import OCCUPIED
from clustermcl.protocol.errors import MapFileError, RecordingError
from clustermcl.recordings.bag_file import OCCUPANCY_GRID, BagFile, is_bag
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.map_message import grid_map_of
from clustermcl.recordings.run_log import is_run_log, last_map
from clustermcl.runtime.compressed import first_bytes, os_problem

_log = logging.getLogger(__name__)


def load_map(path: Path | str) -> GridMap:
    """Read a map; its format is recognised by its content, also if packed by gzip or xz.

    Its remarks are logged.

    Args:
        path: a map_server YAML file, a run log, a ROS bag with a map, or a building of several
            maps; ``BAG#TOPIC`` selects one of several maps of a bag.

    Raises:
        MapFileError: the map cannot be read.
    """
    grid_map = _loaded(Path(path))
    for remark in grid_map.remarks:
        _log.warning("%s: %s", path, remark)
    return grid_map


def _loaded(named: Path, *, is_floor: bool = False) -> GridMap:
    try:
        return _read(*_split_topic(named), is_floor=is_floor)
    except OSError as error:  # of a folder that may not be searched, or a name that is too long
        raise MapFileError(Path(error.filename or named), os_problem(error)) from error


def _read(path: Path, topic: str, *, is_floor: bool) -> GridMap:
    if is_run_log(path):
        try:
            return last_map(path)
        except RecordingError as error:
            raise MapFileError(path, error.problem) from error
    if is_bag(path):
        return _load_bag_map(path, topic)
    # Pillow and PyYAML take 40 ms to import; processes that get their map over the wire do without.
    from clustermcl.recordings.maps.building import is_building, load_building  # noqa: PLC0415 - see above
    from clustermcl.recordings.maps.ros_map import MAX_HEADER_BYTES, load_ros_map  # noqa: PLC0415 - see above

    content = first_bytes(path, MAX_HEADER_BYTES + 1, MapFileError)
    if not content.strip():
        raise MapFileError(path, "empty; expected a map_server YAML file")
    if not is_building(content):
        return load_ros_map(content, path)
    if is_floor:
        raise MapFileError(path, "is a building; a floor is a single map")
    return load_building(content, path, lambda file: _loaded(file, is_floor=True))


def load_map_with_obstacles(path: Path | str) -> GridMap:
    """Read a map for localization, without logging its remarks.

    Raises:
        MapFileError: the map cannot be read, or has no occupied cell.
    """
    grid_map = _loaded(Path(path))
    if not np.any(grid_map.cells == OCCUPIED):
        problem = "no obstacle: no cell is occupied, so a scan has nothing to be compared with"
        raise MapFileError(Path(path), problem)
    return grid_map


def map_file_of(named: str, recording: str) -> str:
    """Return `named`; if empty, the recording if it is a bag, which may hold a map, or ""."""
    return named or (recording if is_bag(Path(recording)) else "")


def _split_topic(path: Path) -> tuple[Path, str]:
    """Split ``FILE#TOPIC`` into file and topic; without a topic, the second is empty."""
    if path.exists() or "#" not in str(path):
        return path, ""
    file, _, topic = str(path).rpartition("#")
    return Path(file), topic


def _load_bag_map(path: Path, topic: str) -> GridMap:
    """Return the last map on a topic; empty: the only topic called ``map``, in any namespace."""
    with closing(BagFile(path, MapFileError)) as bag:
        topics = bag.of_type(OCCUPANCY_GRID)
        held = ", ".join(topics) or "none"
        chosen = [t for t in topics if t == topic or (not topic and f"/{t}".endswith("/map"))]
        if len(chosen) != 1:
            problem = f"no map on {topic or 'a topic called map'}; it has maps on: {held}"
            remedy = f"name a map file by --map, or one of these as --map {path}#TOPIC"
            raise MapFileError(path, f"{problem}; {remedy}")
        sent = deque(bag.messages(chosen), maxlen=1)
        if not sent:
            raise MapFileError(path, f"{chosen[0]}: {bag.left_out[0].problem}")
    try:
        return grid_map_of(sent[0].content)
    except ValueError as problem:
        raise MapFileError(path, f"{chosen[0]}: {problem}") from problem
