from functools import partial
from pathlib import Path
from threading import Timer

import zenoh
from msgspec.structs import replace

from clustermcl.protocol import keys
from clustermcl.protocol.codec import encode
from clustermcl.protocol.message import MAX_SCAN_STEP
from clustermcl.protocol.steps import Scan
from tests.integration.conftest import OpenClient
from tests.integration.sensor_bridge.conftest import StartBridge
from tests.integration.sensor_bridge.robot import answering
from tests.integration.sensor_bridge.test_published_map import FIRST
from tests.integration.sensor_bridge.test_standing_robot import Standing
from tests.integration.waiting import wait_until
from tests.integration.worlds import write_room
from tests.unit.evaluation.places import STATUS

LATE_S, REFUSALS = 2.0, 5
GOES_ON = max(STATUS.step, STATUS.newest_step) + 1


def test_steps_continue_although_a_busy_coordinator_answers_late(
    start_bridge: StartBridge, open_client: OpenClient
) -> None:
    def answer_late(query: zenoh.Query) -> None:
        def answer() -> None:
            with query:
                query.reply(keys.STATUS, encode(STATUS))

        Timer(LATE_S, answer).start()

    open_client().declare_queryable(keys.STATUS, answer_late)
    assert first_step(start_bridge, open_client) == GOES_ON


def test_steps_continue_although_a_coordinator_whose_link_just_returned_refuses_to_answer(
    start_bridge: StartBridge, open_client: OpenClient
) -> None:
    """It refused once, and all places were forgotten: seen after a router had locked up."""
    asked = list[zenoh.Query]()

    def refuse_at_first(query: zenoh.Query) -> None:
        asked.append(query)
        with query:
            if len(asked) <= REFUSALS:
                query.reply_err(b"another coordinator may have taken over; ask again")
            else:
                query.reply(keys.STATUS, encode(STATUS))

    open_client().declare_queryable(keys.STATUS, refuse_at_first)
    assert first_step(start_bridge, open_client) == GOES_ON
    assert len(asked) > REFUSALS


def test_steps_continue_although_a_coordinator_that_just_began_answers_a_moment_later(
    start_bridge: StartBridge, open_client: OpenClient
) -> None:
    """Its token is there, its answers are not: steps began at 0, and all places were forgotten."""
    coordinator = open_client()
    token = coordinator.liveliness().declare_token(keys.COORDINATOR_ALIVE)

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(keys.STATUS, encode(STATUS))

    late = Timer(LATE_S, partial(coordinator.declare_queryable, keys.STATUS, answer))

    def on_reading(_sample: zenoh.Sample) -> None:
        if late.ident is None:
            late.start()

    coordinator.declare_subscriber(keys.LASER_READING, on_reading)
    assert first_step(start_bridge, open_client) == GOES_ON
    token.undeclare()


def test_a_bridge_without_readings_reports_what_it_waits_for(
    start_bridge: StartBridge, tmp_path: Path
) -> None:
    robot = start_bridge(write_room(tmp_path))
    assert robot.bridge
    robot.bridge.wait_for("waiting for scans on robot/readings/laser")
    robot.bridge.wait_for("waiting for odometry on robot/readings/odometry")


def test_near_the_highest_possible_step_numbering_restarts(
    start_bridge: StartBridge, open_client: OpenClient
) -> None:
    far = replace(STATUS, newest_step=MAX_SCAN_STEP // 2)

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(keys.STATUS, encode(far))

    open_client().declare_queryable(keys.STATUS, answer)
    assert first_step(start_bridge, open_client) == 0


def first_step(start_bridge: StartBridge, open_client: OpenClient) -> int:
    with answering(open_client(), FIRST):
        robot = start_bridge()
        standing = Standing(robot)

        def steps() -> list[Scan]:
            standing.scan()  # it may still be without a map
            return robot.steps()

        wait_until(lambda: bool(steps()))
        return robot.steps()[0].step
