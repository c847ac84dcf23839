"""Map files of ROS's map_server."""

from pathlib import Path

import numpy as np
from PIL import Image

from clustermcl.filter.arrays import FREE, OCCUPIED
from clustermcl.recordings.maps.grid_map import GridMap

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
    """Write ``name.yaml`` and ``name.pgm`` into a folder; return the path of the YAML file."""
    grey = np.full(grid_map.cells.shape, 205, np.uint8)
    grey[grid_map.cells == FREE] = 254
    grey[grid_map.cells == OCCUPIED] = 0
    Image.fromarray(grey[::-1]).save(folder / f"{name}.pgm")  # the first row of an image is the top
    x, y, heading = grid_map.map_from_grid
    path = folder / f"{name}.yaml"
    origin = f"[{x!r}, {y!r}, {heading!r}]"
    path.write_text(header(image=f"{name}.pgm", resolution=f"{grid_map.cell_m!r}", origin=origin))
    return path
