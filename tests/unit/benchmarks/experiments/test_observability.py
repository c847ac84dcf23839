from collections.abc import Iterator

import pytest

from benchmarks.experiments.observability import ScanObservability, turned_copies
from benchmarks.people import CrowdSimulation
from evaluation.map_check.symmetries import middle_of
from process_runtime.settings import BridgeSettings
from protocol.message import PoseTuple
from protocol.steps import Scan
from robot_simulator.source import SimulatedSource, simulated_steps
from robot_simulator.worlds.catalogue import world


def steps(name: str, count: int, people: int = 0) -> Iterator[tuple[Scan, PoseTuple]]:
    source = SimulatedSource(CrowdSimulation(world(name), 0, people), steps=count)
    return simulated_steps(source, BridgeSettings(), "digest")


@pytest.mark.parametrize(("name", "times"), [("cross", 4), ("rectangle", 2), ("hall_symmetric", 2)])
def test_nothing_distinguishes_the_copies_of_a_symmetric_world(name: str, times: int) -> None:
    grid_map = world(name).map
    observability, middle = ScanObservability(grid_map), middle_of(grid_map)
    assert not any(
        observability.distinguishes(scan, turned_copies(truth, times, middle))
        for scan, truth in steps(name, 80)
    )
