from collections.abc import Iterator

import numpy as np
import pytest

from benchmarks.experiments.observability import ScanObservability, turned_copies
from evaluation.map_check.symmetries import middle_of
from grid_maps.grid_map import GridMap
from process_runtime.settings import BridgeSettings
from protocol.message import PoseTuple
from protocol.steps import Scan
from robot_simulator.simulation import Simulation
from robot_simulator.source import SimulatedSource, simulated_steps
from robot_simulator.worlds.catalogue import world


def steps(name: str, count: int, people: int = 0) -> Iterator[tuple[Scan, PoseTuple]]:
    source = SimulatedSource(Simulation(world(name), 0, people=people), steps=count)
    return simulated_steps(source, BridgeSettings(), "digest")


@pytest.mark.parametrize(("name", "times"), [("cross", 4), ("rectangle", 2), ("hall_symmetric", 2)])
def test_nothing_distinguishes_the_copies_of_a_symmetric_world(name: str, times: int) -> None:
    grid_map = world(name).map
    observability, middle = ScanObservability(grid_map), middle_of(grid_map)
    assert not any(
        observability.distinguishes(scan, turned_copies(truth, times, middle))
        for scan, truth in steps(name, 80)
    )


def test_places_differ_by_the_map_not_by_the_measured_scan() -> None:
    cells = np.zeros((40, 40), dtype=np.int8)
    cells[:, 39] = 1  # a wall in the east, and something in front of it
    cells[19:22, 36] = 1
    observability = ScanObservability(GridMap(cells, 0.25, (0.0, 0.0, 0.0)))
    scan, _ = next(steps("cross", 1))
    before, after = (4.0, 5.1, 0.0), (4.0, 2.0, 0.0)
    assert observability.distinguishes(scan, (before, after))
    assert not observability.distinguishes(scan, (before, before))
    with pytest.raises(ValueError, match="no other place"):
        observability.distinguishes(scan, (before,))


def test_without_people_no_beam_is_short_and_with_many_a_third_is() -> None:
    observability = ScanObservability(world("hall").map)
    assert max(observability.short_share(*step) for step in steps("hall", 30)) < 0.02
    crowded = [observability.short_share(*step) for step in steps("hall", 60, people=22)]
    assert 0.2 < np.mean(crowded) < 0.4
