"""Map files of ROS's map_server."""

from pathlib import Path

import numpy as np
from PIL import Image

from grid_maps.grid_map import GridMap
from particle_filter.arrays import FREE, OCCUPIED


def write_map(grid_map: GridMap, folder: Path, name: str) -> Path:
    """Write ``name.yaml`` and ``name.pgm`` into a folder; return the path of the YAML file."""
    grey = np.full(grid_map.cells.shape, 205, np.uint8)
    grey[grid_map.cells == FREE] = 254
    grey[grid_map.cells == OCCUPIED] = 0
    Image.fromarray(grey[::-1]).save(folder / f"{name}.pgm")  # the first row of an image is the top
    x, y, heading = grid_map.map_from_grid
    path = folder / f"{name}.yaml"
    path.write_text(
        f"image: {name}.pgm\nresolution: {grid_map.cell_m!r}\n"
        f"origin: [{x!r}, {y!r}, {heading!r}]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
        encoding="utf-8",
    )
    return path
