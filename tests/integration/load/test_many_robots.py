"""Robots behind one router: each localizes, by its own readings alone."""

import math
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh
from msgspec.structs import replace

from particle_filter.settings import BeliefSettings, ClusterSettings, SearchSettings
from process_runtime.settings import (
    BridgeSettings,
    CoordinatorSettings,
    RobotSettings,
    Settings,
    WorkerSettings,
    ZenohSettings,
)
from process_runtime.stop import StopFlag
from protocol import keys
from protocol.answers import Belief
from protocol.codec import decode
from protocol.message import PoseTuple
from tests.integration.waiting import PATIENCE_S, wait_until
from tests.soak.driver import TRUTH_KEY, TrueMotion
from tests.soak.fleet import Fleet
from zenoh_link.session import open_session

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


class Robot:
    """Compares beliefs and true poses of one robot; those of another have other stamps.

    Args:
        session: of this robot.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._truth: dict[int, PoseTuple] = {}
        self._right, self.is_localized = 0, False
        session.declare_subscriber(TRUTH_KEY, self._on_truth)
        session.declare_subscriber(keys.BELIEF, self._on_belief)

    def _on_truth(self, sample: zenoh.Sample) -> None:
        truth = decode(sample.payload.to_bytes(), TrueMotion)
        self._truth[truth.stamp_ns] = truth.map_from_robot

    def _on_belief(self, sample: zenoh.Sample) -> None:
        belief = decode(sample.payload.to_bytes(), Belief)
        truth = self._truth.get(belief.stamp_ns)
        is_right = (
            truth is not None
            and belief.state == "localized"
            and math.dist(belief.hypotheses[0].pose[:2], truth[:2]) < LOCALIZED_M
        )
        self._right = self._right + 1 if is_right else 0
        self.is_localized |= self._right >= LOCALIZED_STEPS


def assert_each_finds_itself(robots: int, at_most_s: float, folder: Path) -> None:
    router = ZenohSettings(router=f"unixsock-stream/{folder}/router.sock")
    worker = replace(SETTINGS.worker, cache_folder=str(folder / "cache"))
    each = [
        replace(
            SETTINGS, zenoh=router, worker=worker, seed=SETTINGS.seed + number,
            robot=RobotSettings(name=f"robot-{number}"),
        )
        for number in range(1, robots + 1)
    ]  # fmt: skip
    fleet = Fleet(each, folder, world=WORLD, rate_hz=RATE_HZ, coordinators=1, cables=False)
    fleet.start()
    try:
        with ExitStack() as opened:
            heard = {}
            for one in each:
                session = open_session(router, one.robot, StopFlag(), wait_s=PATIENCE_S)
                heard[one.robot.name] = Robot(opened.enter_context(session))

            def all_are_localized() -> bool:
                fleet.poll()
                return all(robot.is_localized for robot in heard.values())

            wait_until(all_are_localized, at_most_s)
    finally:
        fleet.stop()


def test_three_robots_localize_and_receive_nothing_of_each_other(short_folder: str) -> None:
    assert_each_finds_itself(3, PATIENCE_S, Path(short_folder))


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_twenty_robots_localize_and_receive_nothing_of_each_other(short_folder: str) -> None:
    assert_each_finds_itself(20, 600.0, Path(short_folder))
