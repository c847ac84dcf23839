"""A robot whose field of view is shared by two lasers, one of them on its head."""

import math
from collections.abc import Iterator

import msgspec

from evaluation.in_process import outcomes
from particle_filter.sensor_models import computed_model
from process_runtime.settings import BridgeSettings
from protocol.arrays import ArrayBlob
from protocol.codec import decode, encode
from protocol.steps import LaserReading, Reading, Scan
from robot_simulator.simulation import Simulation
from robot_simulator.worlds.catalogue import world
from sensor_bridge.step_maker import StepMaker
from tests.integration.system.conftest import SMALL

STEPS = 80
HEADING = 0.7
"""Of the laser that is on its head."""


def shared(reading: Reading) -> list[Reading]:
    """The right half of a scan from one laser, the left half from another."""
    if not isinstance(reading, LaserReading):
        return [reading]
    ranges = reading.ranges.array()
    half = len(ranges) // 2
    right = msgspec.structs.replace(
        reading, laser="right", ranges=ArrayBlob.of(ranges[:half], "float32")
    )
    x, y, heading = reading.robot_from_laser
    last_rad = reading.angle_min_rad + reading.angle_step_rad * (len(ranges) - 1)
    left = msgspec.structs.replace(
        reading,
        laser="left",
        upside_down=True,
        ranges=ArrayBlob.of(ranges[half:][::-1], "float32"),
        angle_min_rad=HEADING - last_rad,
        robot_from_laser=(x, y, heading + HEADING),
    )
    return [left, right]


def steps(simulation: Simulation) -> Iterator[tuple[Scan, tuple[float, float, float]]]:
    maker = StepMaker(BridgeSettings(), "digest", "bridge")
    made = 0
    for tick in simulation:
        for reading in (one for whole in tick.readings for one in shared(whole)):
            if (scan := maker.on_reading(reading)) is not None:
                yield decode(encode(scan), Scan), simulation.truth_at(scan.stamp_ns)
                made += 1
        if made >= STEPS:
            return


def test_two_lasers_find_the_robot_as_one_does() -> None:
    cross = world("cross_feature")
    grid = cross.map.grid
    model = computed_model(grid, SMALL.sensor)
    reported = list(steps(Simulation(cross, seed=4)))
    assert sum(len(scan.others) == 1 for scan, _ in reported) >= STEPS - 1
    results = [outcome for _, outcome in outcomes([scan for scan, _ in reported], model, SMALL)]
    truth = reported[-1][1]
    best = min(
        (math.dist(place.pose[:2], truth[:2]) for place in results[-1].hypotheses), default=math.inf
    )
    assert best < 0.2
    assert results[-1].state in ("ambiguous", "localized")
