import math
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
import zenoh
from msgspec.structs import replace

from clustermcl.filter.settings import BeliefSettings, ClusterSettings, SearchSettings
from clustermcl.link.session import open_session
from clustermcl.protocol import keys
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.codec import decode
from clustermcl.protocol.message import PoseTuple
from clustermcl.runtime import settings
from clustermcl.runtime.stop import StopFlag
from tests.integration.waiting import PATIENCE_S, wait_until
from tests.soak.driver import TRUTH_KEY, TrueMotion
from tests.soak.fleet import POOL, Fleet

WORLD = "hall"
RATE_HZ = 2.0
"""Scans a second, each a step. The robots' time passes a fifth as fast, at 0.12 m/s."""
SETTINGS = settings.Settings(
    seed=100,
    cluster=ClusterSettings(particles=300),
    search=SearchSettings(heading_step_rad=0.1, poses=8_000),
    belief=BeliefSettings(max_clusters=4),
    bridge=settings.BridgeSettings(source="zenoh", gate_distance_m=0.0, gate_turn_rad=0.0),
    coordinator=settings.CoordinatorSettings(state_folder="off"),
    worker=settings.WorkerSettings(count=2),
)
FLOOD = 20
"""Messages without a meaning that one robot publishes every few milliseconds."""
LOCALIZED_M, LOCALIZED_STEPS = 1.0, 5
"""At most this far from the truth, for this number of steps in a row."""


class Robot:
    """Compares beliefs and true poses of one robot; those of another have other stamps."""

    def __init__(self, session: zenoh.Session) -> None:
        self._truth: dict[int, PoseTuple] = {}
        self._right, self.is_localized = 0, False
        self.beliefs: list[Belief] = []
        session.declare_subscriber(TRUTH_KEY, self._on_truth)
        session.declare_subscriber(keys.BELIEF, self._on_belief)

    def _on_truth(self, sample: zenoh.Sample) -> None:
        truth = decode(sample.payload.to_bytes(), TrueMotion)
        self._truth[truth.stamp_ns] = truth.map_from_robot

    def _on_belief(self, sample: zenoh.Sample) -> None:
        belief = decode(sample.payload.to_bytes(), Belief)
        self.beliefs.append(belief)
        truth = self._truth.get(belief.stamp_ns)
        is_right = (
            truth is not None
            and belief.state == "localized"
            and math.dist(belief.hypotheses[0].pose[:2], truth[:2]) < LOCALIZED_M
        )
        self._right = self._right + 1 if is_right else 0
        self.is_localized |= self._right >= LOCALIZED_STEPS


@contextmanager
def localized_robots(
    count: int, at_most_s: float, folder: Path, *, pool: bool = False
) -> Iterator[tuple[Fleet, dict[zenoh.Session, Robot]]]:
    router = settings.ZenohSettings(router=f"unixsock-stream/{folder}/router.sock")
    worker = replace(SETTINGS.worker, cache_folder=str(folder / "cache"))
    each = [
        replace(
            SETTINGS, zenoh=router, worker=worker, seed=SETTINGS.seed + number,
            robot=settings.RobotSettings(name=f"robot-{number}"),
        )
        for number in range(1, count + 1)
    ]  # fmt: skip
    fleet = Fleet(each, folder, world=WORLD, rate_hz=RATE_HZ, coordinators=1, pool=pool)
    fleet.start()
    try:
        with ExitStack() as opened:
            robots = {}
            for one in each:
                opening = open_session(router, one.robot, StopFlag(), wait_s=PATIENCE_S)
                session = opened.enter_context(opening)
                robots[session] = Robot(session)

            def all_are_localized() -> bool:
                fleet.poll()
                return all(robot.is_localized for robot in robots.values())

            wait_until(all_are_localized, at_most_s)
            yield fleet, robots
    finally:
        fleet.stop()


def test_a_pool_serves_three_robots_and_neither_a_kill_nor_a_flood_costs_an_update(
    short_folder: str,
) -> None:
    with localized_robots(3, PATIENCE_S, Path(short_folder), pool=True) as (fleet, robots):
        (flooded, _), *others = robots.items()
        pool = [part for part in fleet.parts() if part.own_name.startswith(f"{POOL}-")]
        assert len(pool) == 2, "processes for three robots"
        before = {robot: len(robot.beliefs) for robot in robots.values()}
        pool[0].process.kill()

        def all_go_on() -> bool:
            fleet.poll()
            return all(len(robot.beliefs) > before[robot] + 10 for robot in robots.values())

        wait_until(all_go_on)
        junk = flooded.declare_publisher(keys.SCAN)
        begun = {robot: len(robot.beliefs) for _, robot in others}

        def others_go_on() -> bool:
            for _ in range(FLOOD):
                junk.put(b"junk" * 1_000)
            return all(len(robot.beliefs) > begun[robot] + 10 for _, robot in others)

        wait_until(others_go_on)
        for _, robot in others:
            assert not any(belief.missing for belief in robot.beliefs[begun[robot] :])
            assert robot.beliefs[-1].state == "localized"


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_twenty_robots_localize_and_receive_nothing_of_each_other(short_folder: str) -> None:
    with localized_robots(20, 600.0, Path(short_folder)):
        pass
