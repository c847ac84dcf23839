"""Robots behind one router: each localizes, by its own readings alone."""

import math
import time
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import pytest
import zenoh

from particle_filter.settings import BeliefSettings, ClusterSettings, SearchSettings
from process_runtime.settings import (
    BridgeSettings,
    CoordinatorSettings,
    RobotSettings,
    Settings,
    WorkerSettings,
    ZenohSettings,
)
from protocol import keys
from protocol.answers import Belief
from protocol.codec import decode
from protocol.message import PoseTuple
from protocol.steps import LaserReading, Scan
from robot_simulator.driver import TRUTH_KEY, TrueMotion
from tests.soak.fleet import Fleet
from zenoh_link.configuration import as_zenoh, client_configuration

WORLD = "hall"
RATE_HZ = 2.0
"""Scans a second, each a step. The robots' time passes a fifth as fast, at 0.12 m/s."""
SETTINGS = Settings(
    seed=100,
    cluster=ClusterSettings(particles=300),
    search=SearchSettings(heading_step_rad=0.1, poses=8_000),
    belief=BeliefSettings(max_clusters=4),
    bridge=BridgeSettings(source="zenoh", gate_distance_m=0.0, gate_turn_rad=0.0),
    coordinator=CoordinatorSettings(state_folder="off"),
    worker=WorkerSettings(count=2),
)
LOCALIZED_M, LOCALIZED_STEPS = 1.0, 5
"""At most this far from the truth, for this number of steps in a row."""


@dataclass
class Robot:
    """Messages received in one robot's namespace."""

    laser_stamps_ns: set[int] = field(default_factory=set)
    truth: dict[int, PoseTuple] = field(default_factory=dict)
    told_stamps_ns: list[int] = field(default_factory=list)
    """Of the steps and beliefs that its system made of its readings."""
    errors_m: list[float] = field(default_factory=list)
    """Of the most probable place, belief by belief."""
    is_localized: bool = False

    def made_of(self, stamps_ns: set[int]) -> int:
        """How many of its steps and beliefs are made of readings with these stamps."""
        return sum(stamp_ns in stamps_ns for stamp_ns in self.told_stamps_ns)


def strangers(name: str, heard: dict[str, Robot]) -> int:
    """Steps and beliefs of a robot that are made of another's readings."""
    return sum(heard[name].made_of(r.laser_stamps_ns) for n, r in heard.items() if n != name)


class Everything:
    """Hears all that is said on the router, whichever robot it is about."""

    def __init__(self, session: zenoh.Session) -> None:
        self.robots: dict[str, Robot] = {}
        session.declare_subscriber("**", self._on_sample)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        name, _, key = str(sample.key_expr).partition("/")
        robot = self.robots.setdefault(name, Robot())
        payload = sample.payload.to_bytes()
        match key:
            case keys.LASER_READING:
                robot.laser_stamps_ns.add(decode(payload, LaserReading).stamp_ns)
            case keys.SCAN:
                robot.told_stamps_ns.append(decode(payload, Scan).stamp_ns)
            case keys.BELIEF:
                self._on_belief(robot, decode(payload, Belief))
            case _ if key == TRUTH_KEY:
                truth = decode(payload, TrueMotion)
                robot.truth[truth.stamp_ns] = truth.map_from_robot

    def _on_belief(self, robot: Robot, belief: Belief) -> None:
        robot.told_stamps_ns.append(belief.stamp_ns)
        truth = robot.truth.get(belief.stamp_ns)
        if belief.state != "localized" or truth is None:
            robot.errors_m.append(math.inf)
            return
        robot.errors_m.append(math.dist(belief.hypotheses[0].mean[:2], truth[:2]))
        robot.is_localized |= max(robot.errors_m[-LOCALIZED_STEPS:]) < LOCALIZED_M


def run_robots(robots: int, at_most_s: float, folder: Path) -> dict[str, Robot]:
    """Run all robots until each has localized or time is up; return each one's messages."""
    router = ZenohSettings(router=f"unixsock-stream/{folder}/router.sock")
    worker = msgspec.structs.replace(SETTINGS.worker, cache_folder=str(folder / "cache"))
    settings = msgspec.structs.replace(SETTINGS, zenoh=router, worker=worker)
    each = [
        msgspec.structs.replace(
            settings, robot=RobotSettings(name=f"robot-{number}"), seed=settings.seed + number
        )
        for number in range(1, robots + 1)
    ]
    fleet = Fleet(each, folder, world=WORLD, rate_hz=RATE_HZ, coordinators=1, cables=False)
    fleet.start()
    try:
        with _session_of_no_robot(settings) as session:
            heard = Everything(session)
            until_s = time.monotonic() + at_most_s
            while time.monotonic() < until_s and not _all_localized(heard, robots):
                fleet.poll()
                time.sleep(0.1)
            return dict(heard.robots)
    finally:
        fleet.stop()


def _all_localized(heard: Everything, robots: int) -> bool:
    return sum(robot.is_localized for robot in heard.robots.values()) == robots


def _session_of_no_robot(settings: Settings) -> zenoh.Session:
    """A session without a namespace, unlike our processes; the router may still be starting."""
    configuration = client_configuration(settings.zenoh, settings.robot)
    del configuration["namespace"]
    while True:
        try:
            return zenoh.open(as_zenoh(configuration))
        except zenoh.ZError:
            time.sleep(0.1)


def assert_each_finds_itself(robots: int, at_most_s: float, folder: Path) -> None:
    heard = run_robots(robots, at_most_s, folder)
    assert len(heard) == robots
    for name, robot in heard.items():
        assert robot.is_localized, f"{name}: {robot.errors_m[-5:]}"
        # Not all: under load, the subscriber to everything misses some readings.
        assert robot.made_of(robot.laser_stamps_ns) > len(robot.told_stamps_ns) / 2, name
        assert strangers(name, heard) == 0, name
    stamps = [stamp_ns for robot in heard.values() for stamp_ns in robot.laser_stamps_ns]
    assert len(set(stamps)) == len(stamps), "no two readings have one stamp, so they tell whose"


def test_three_robots_localize_and_receive_nothing_of_each_other(short_folder: str) -> None:
    assert_each_finds_itself(3, 90.0, Path(short_folder))


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_twenty_robots_localize_and_receive_nothing_of_each_other(short_folder: str) -> None:
    assert_each_finds_itself(20, 600.0, Path(short_folder))
