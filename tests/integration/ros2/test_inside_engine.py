"""The engine inside of AMCL's node: the filter in a thread, without Zenoh and without ROS."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace as replaced
from itertools import islice
from typing import Any

import numpy as np
import pytest
from clustermcl_ros.inside import InsideEngine
from msgspec.structs import replace

from clustermcl.filter.arrays import UNKNOWN
from clustermcl.filter.poses import compose
from clustermcl.filter.settings import SearchSettings
from clustermcl.localizer import Belief
from clustermcl.protocol.advice import Advice
from clustermcl.protocol.answers import Configure, Relocalize, SetPose, Update
from clustermcl.protocol.causes import AnyCause
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.live_settings import LiveSettings
from clustermcl.protocol.steps import OdometryReading
from clustermcl.protocol.work import Particles
from clustermcl.ros2.sides import EngineStatus, Reading
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.alone import assert_same, outcomes_of_scans
from tests.integration.faults.system import SMALL
from tests.integration.running import running
from tests.integration.waiting import wait_until
from tests.integration.worlds import map_reading

WORLD = world("cross_feature")
KEEPING = replace(SMALL.coordinator, keep_pose_on_new_map=True)
QUICK = replace(SMALL, search=SearchSettings(poses=2_000, max_steps=20), coordinator=KEEPING)


class Heard:
    """Keeps what the engine reports."""

    def __init__(self) -> None:
        self.beliefs, self.advice = list[Belief](), list[Advice]()
        self.on_belief, self.on_advice = self.beliefs.append, self.advice.append
        self.clusters, self.refused = list[int](), list[str]()
        self.status: EngineStatus | None = None
        self.new_maps = 0

    def on_particles(self, cluster: int, particles: Particles) -> None:
        assert len(particles.log_weights.array()) > 0
        self.clusters.append(cluster)

    def on_changes(self, _changes: Changes) -> None:
        pass

    def on_new_map(self) -> None:
        self.new_maps += 1

    def on_status(self, status: EngineStatus | None) -> None:
        self.status = status

    def on_refused(self, cause: AnyCause, detail: str) -> None:
        self.refused.append(f"{cause}: {detail}")


class Counting(InsideEngine):
    """Counts what was given, and what of it is done."""

    given = done = 0
    clock: Callable[[float], float] = staticmethod(lambda arrived_s: arrived_s)

    def put(self, reading: Reading) -> None:
        self.given += 1
        super().put(reading)

    def _on_event(self, arrived_s: float, event: Any) -> None:
        super()._on_event(self.clock(arrived_s), event)
        self.done += isinstance(event, Reading)

    @property
    def is_idle(self) -> bool:
        return self.done == self.given


class Driven:
    """An engine with a simulated robot, which waits for the engine after each reading."""

    def __init__(self, engine: Counting, heard: Heard) -> None:
        self.engine, self.heard = engine, heard
        self._ticks = iter(Simulation(WORLD, seed=3))
        self.truth = (0.0, 0.0, 0.0)

    def drive(self, ticks: int) -> None:
        for tick in islice(self._ticks, ticks):
            self.truth = tick.map_from_robot
            for reading in tick.readings:
                self.engine.put(reading)
            wait_until(lambda: self.engine.is_idle)

    def drive_until(self, condition: Callable[[], object]) -> None:
        for _ in range(600):
            self.drive(1)
            if condition():
                return
        pytest.fail("not within a minute of driving")


@pytest.fixture
def driven() -> Iterator[Driven]:
    heard = Heard()
    engine = Counting(QUICK, heard)
    with running(engine.run):
        yield Driven(engine, heard)


def test_beliefs_are_those_of_the_library_bit_for_bit_through_live_settings(driven: Driven) -> None:
    heard = driven.heard
    driven.drive(1)
    assert heard.refused[0].startswith("reading before the map")
    assert heard.status is None
    driven.engine.put(map_reading(WORLD.map))
    driven.drive_until(lambda: heard.beliefs and heard.beliefs[-1].hypotheses)
    driven.engine.command(Configure(sender="amcl", settings=LiveSettings(max_beams=31)))
    driven.drive_until(lambda: len(heard.beliefs) > 40)
    scans = [belief.scan for belief in heard.beliefs]
    assert {scan.settings.max_beams for scan in scans} == {None, 31}
    assert_same(heard.beliefs, outcomes_of_scans(scans, WORLD.map, QUICK))
    assert heard.clusters
    wait_until(lambda: heard.status and heard.status.settings == LiveSettings(max_beams=31))


def test_commands_before_the_map_are_carried_out_with_it_and_a_new_map_keeps_the_pose(
    driven: Driven,
) -> None:
    heard, first = driven.heard, next(iter(Simulation(WORLD, seed=3)))
    driven.engine.command(SetPose(sender="amcl", command_id="", pose=first.map_from_robot))
    wider = np.pad(WORLD.map.cells, ((0, 9), (0, 9)), constant_values=UNKNOWN)
    for cells in (WORLD.map.cells, wider):
        driven.engine.put(map_reading(replaced(WORLD.map, cells=cells)))
        wait_until(lambda: driven.engine.is_idle)
        heard.beliefs.clear()
        driven.drive_until(lambda: heard.beliefs and heard.beliefs[-1].state == "localized")
        assert len(heard.beliefs) < 10
        found = heard.beliefs[-1].hypotheses[0].pose
        assert math.dist(found[:2], driven.truth[:2]) < 0.3
    assert heard.new_maps == 1
    count = len(heard.beliefs)
    driven.engine.command(Relocalize(sender="amcl", command_id=""))
    wait_until(lambda: len(heard.beliefs) > count and heard.beliefs[-1].state == "searching")
    driven.engine.command(Relocalize(sender="amcl", command_id="", floor="attic"))
    wait_until(lambda: any("attic" in one for one in heard.refused))


def test_a_standing_robot_is_searched_for_and_else_makes_steps_only_on_request(
    driven: Driven,
) -> None:
    heard, tick = driven.heard, next(iter(Simulation(WORLD, seed=3)))
    driven.engine.put(map_reading(WORLD.map))
    stamp_ns = tick.laser.stamp_ns

    def stand_until(condition: Callable[[], object]) -> None:
        def holds() -> object:
            nonlocal stamp_ns
            stamp_ns += 100_000_000
            pose = tick.odometry[0].odom_from_robot
            driven.engine.put(OdometryReading(sender="t", stamp_ns=stamp_ns, odom_from_robot=pose))
            driven.engine.put(replace(tick.laser, stamp_ns=stamp_ns, odom_from_robot=pose))
            wait_until(lambda: driven.engine.is_idle)
            return condition()

        wait_until(holds, 60.0)

    stand_until(lambda: heard.beliefs and heard.beliefs[-1].state != "searching")
    count, begun_ns = len(heard.beliefs), stamp_ns
    stand_until(lambda: stamp_ns > begun_ns + 10**9)
    assert len(heard.beliefs) == count
    driven.engine.command(Update(sender="amcl", command_id=""))
    stand_until(lambda: len(heard.beliefs) == count + 1)


def test_an_engine_that_is_late_skips_scans_until_it_has_caught_up(driven: Driven) -> None:
    heard, engine = driven.heard, driven.engine
    engine.put(map_reading(WORLD.map))
    driven.drive_until(lambda: heard.beliefs and heard.beliefs[-1].hypotheses)
    count, late = len(heard.beliefs), True
    engine.clock = lambda arrived_s: arrived_s - 1.0 if late else arrived_s
    driven.drive(30)
    assert len(heard.beliefs) == count
    late = False
    driven.drive_until(lambda: len(heard.beliefs) == count + 1)
    assert heard.beliefs[-1].step == heard.beliefs[-2].step + 1


def test_a_new_map_without_a_pose_is_searched_and_a_map_without_obstacles_is_refused(
    driven: Driven,
) -> None:
    heard, before = driven.heard, WORLD.map
    driven.engine.put(map_reading(replaced(before, cells=np.zeros_like(before.cells))))
    wait_until(lambda: any("no occupied cell" in one for one in heard.refused))
    driven.engine.ask_advice()
    wait_until(lambda: any("no map has" in one for one in heard.refused))
    driven.engine.put(map_reading(before))
    driven.drive_until(lambda: heard.beliefs and heard.beliefs[-1].hypotheses)
    driven.engine.ask_advice()
    wait_until(lambda: heard.advice)
    shift = np.array([10.0, -5.0, 0.0])
    origin = tuple(compose(shift, np.array(before.map_from_grid)).tolist())
    driven.engine.put(map_reading(replaced(before, map_from_grid=origin)))
    driven.drive_until(
        lambda: heard.beliefs[-1].map.map_from_grid == origin and heard.beliefs[-1].hypotheses
    )
    wait_until(lambda: heard.status is not None)
