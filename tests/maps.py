"""Map files of ROS's map_server."""

from pathlib import Path

from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.ros_map import save_ros_map

HEADER = {
    "image": "map.pgm",
    "resolution": "0.05",
    "origin": "[0, 0, 0]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}


def header(**changed: str) -> str:
    return "".join(f"{key}: {value}\n" for key, value in {**HEADER, **changed}.items())


def write_map(grid_map: GridMap, folder: Path, name: str) -> Path:
    """Write ``name.yaml`` and ``name.png`` into a folder; return the path of the YAML file."""
    path = folder / f"{name}.yaml"
    save_ros_map(grid_map, path)
    return path
