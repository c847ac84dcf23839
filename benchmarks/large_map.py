"""A site plan of 16,384 x 16,384 cells with one building: `python -m benchmarks.large_map`.

How long `clustermcl up` takes to the first places, the first time and with what it keeps on disk,
and the most memory of all its processes (proportional set size, `benchmarks.memory`).
"""

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.memory import measured
from clustermcl.filter.arrays import UNKNOWN
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.ros_map import save_ros_map
from clustermcl.simulator.worlds.office import office


def site_plan(building: GridMap, side: int) -> GridMap:
    """A square map of `side` x `side` cells; everything around the building is unknown."""
    cells = np.full((side, side), UNKNOWN, np.int8)
    rows, cols = building.cells.shape
    low, left = (side - rows) // 3, (side - cols) // 3
    cells[low : low + rows, left : left + cols] = building.cells
    return GridMap(cells, building.cell_m, (0.0, 0.0, 0.0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--side", type=int, default=16_384, help="cells")
    parser.add_argument("--wings", type=int, default=14)
    parser.add_argument("--rooms", type=int, default=54)
    parser.add_argument("--timeout", type=float, default=400.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        building = office(options.wings, options.rooms).map
        map_file = Path(name, "map.yaml")
        save_ros_map(site_plan(building, options.side), map_file)
        settings = [f"bridge.source=sim:{map_file}", f"worker.cache_folder={name}/cache"]
        settings.append(f"recorder.folder={name}/recorder")
        for which in ("first time", "with what is kept on disk"):
            print(f"## {which}", flush=True)
            sizes = measured(settings, 10.0, options.timeout)
            for part, each in sorted(sizes.items()):
                print(f"  {part}: {len(each)} x {np.mean(each):.1f} MB")
            print(f"load average {os.getloadavg()[0]:.1f}", flush=True)


if __name__ == "__main__":
    main()
