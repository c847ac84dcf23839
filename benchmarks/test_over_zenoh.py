"""From a laser reading to the belief, through bridge, workers and coordinator: real processes."""

import queue
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
import zenoh
from pytest_benchmark.fixture import BenchmarkFixture

from clustermcl.link.wire import Publisher
from clustermcl.protocol import keys
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.codec import decode
from clustermcl.runtime.settings import BridgeSettings, WorkerSettings
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.faults.system import SMALL, System, system
from tests.maps import write_map

PARTICLES = 1_000


class Robot:
    """Drives a tenth of a second at a time and waits for what is believed then."""

    def __init__(self, tested: System) -> None:
        self._simulation = Simulation(world("cross"), seed=1)
        self._laser = Publisher(tested.session, keys.LASER_READING)
        self._odometry = Publisher(tested.session, keys.ODOMETRY_READING)
        self._beliefs = queue.SimpleQueue[Belief]()
        tested.session.declare_subscriber(keys.BELIEF, self._on_belief)

    def _on_belief(self, sample: zenoh.Sample) -> None:
        self._beliefs.put(decode(sample.payload.to_bytes(), Belief))

    def step(self, patience_s: float = 5.0) -> bool:
        """Publish what the sensors read; whether a belief came of it."""
        tick, now_ns = next(self._simulation), time.time_ns()
        scan_ns = now_ns - 1_000_000
        before, after = tick.odometry
        self._odometry.put(msgspec.structs.replace(before, stamp_ns=now_ns - 2_000_000))
        self._odometry.put(msgspec.structs.replace(after, stamp_ns=now_ns))
        self._laser.put(msgspec.structs.replace(tick.laser, stamp_ns=scan_ns))
        try:
            while self._beliefs.get(timeout=patience_s).stamp_ns != scan_ns:
                pass  # of an earlier step
        except queue.Empty:
            return False
        return True


@pytest.fixture
def robot() -> Iterator[Robot]:
    with tempfile.TemporaryDirectory(prefix="mcl-map-") as folder:
        map_file = write_map(world("cross").map, Path(folder), "map")
        settings = msgspec.structs.replace(
            SMALL,
            bridge=BridgeSettings(
                map=str(map_file), source="zenoh", gate_distance_m=0.0, gate_turn_rad=0.0
            ),
            cluster=msgspec.structs.replace(SMALL.cluster, particles=PARTICLES),
            worker=WorkerSettings(count=SMALL.belief.max_clusters),
        )
        with system(settings) as tested:
            robot = Robot(tested)
            deadline_s = time.monotonic() + 60.0
            while not tested.tracks():
                robot.step(patience_s=0.3)
                assert time.monotonic() < deadline_s, tested.log("coordinator")
            yield robot


def test_four_clusters_from_reading_to_belief(benchmark: BenchmarkFixture, robot: Robot) -> None:
    assert benchmark.pedantic(robot.step, rounds=100, warmup_rounds=20)
