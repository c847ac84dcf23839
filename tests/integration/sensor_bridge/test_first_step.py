from functools import partial
from pathlib import Path
from threading import Timer

import pytest
import zenoh
from msgspec.structs import replace

from clustermcl.protocol import keys
from clustermcl.protocol.answers import CommandDone, Status, Update
from clustermcl.protocol.codec import encode
from clustermcl.protocol.message import MAX_SCAN_STEP
from clustermcl.protocol.steps import Scan
from tests.integration.conftest import OpenClient
from tests.integration.sensor_bridge.conftest import StartBridge
from tests.integration.sensor_bridge.robot import Standing, answering
from tests.integration.sensor_bridge.test_published_map import FIRST
from tests.integration.waiting import answered, wait_until
from tests.integration.worlds import write_room
from tests.unit.evaluation.places import STATUS

LATE_S, REFUSALS = 2.0, 5
GOES_ON = max(STATUS.step, STATUS.newest_step) + 1
FAR = replace(STATUS, newest_step=MAX_SCAN_STEP // 2)


def serve_status(
    session: zenoh.Session, status: Status, late_s: float = 0.0, refusals: int = 0
) -> list[zenoh.Query]:
    """Answer queries for the status; return those that have come."""
    asked = list[zenoh.Query]()

    def on_query(query: zenoh.Query) -> None:
        asked.append(query)
        Timer(late_s, partial(answer, query, is_refused=len(asked) <= refusals)).start()

    def answer(query: zenoh.Query, *, is_refused: bool) -> None:
        with query:
            if is_refused:
                query.reply_err(b"another coordinator may have taken over; ask again")
            else:
                query.reply(keys.STATUS, encode(status))

    session.declare_queryable(keys.STATUS, on_query)
    return asked


@pytest.mark.parametrize(
    ("status", "late_s", "refusals", "step"),
    [(STATUS, LATE_S, 0, GOES_ON), (STATUS, 0.0, REFUSALS, GOES_ON), (FAR, 0.0, 0, 0)],
    ids=["a busy coordinator answers late", "one whose link just returned", "no room for numbers"],
)
def test_steps_continue_after_those_that_a_coordinator_knows(
    start_bridge: StartBridge,
    open_client: OpenClient,
    status: Status,
    late_s: float,
    refusals: int,
    step: int,
) -> None:
    """When it refused once, all places were forgotten: seen after a router had locked up."""
    asked = serve_status(open_client(), status, late_s, refusals)
    assert first_step(start_bridge, open_client) == step
    assert len(asked) > refusals


def test_steps_continue_although_a_coordinator_that_just_began_answers_a_moment_later(
    start_bridge: StartBridge, open_client: OpenClient
) -> None:
    """Its token is there, its answers are not: steps began at 0, and all places were forgotten."""
    coordinator = open_client()
    token = coordinator.liveliness().declare_token(keys.COORDINATOR_ALIVE)
    late = Timer(LATE_S, partial(serve_status, coordinator, STATUS))

    def on_reading(_sample: zenoh.Sample) -> None:
        if late.ident is None:
            late.start()

    coordinator.declare_subscriber(keys.LASER_READING, on_reading)
    assert first_step(start_bridge, open_client) == GOES_ON
    token.undeclare()


def test_a_bridge_reports_what_it_waits_for_and_an_update_requested_twice_makes_one_step(
    start_bridge: StartBridge, open_client: OpenClient, tmp_path: Path
) -> None:
    robot, session = start_bridge(write_room(tmp_path)), open_client()
    assert robot.bridge
    robot.bridge.wait_for("waiting for scans on robot/readings/laser")
    robot.bridge.wait_for("waiting for odometry on robot/readings/odometry")
    standing = Standing(robot)
    standing.scan()
    update = Update(sender="test", command_id="once")
    for _ in range(2):
        assert answered(session, keys.UPDATE, CommandDone, update).problem == ""
        standing.scan()
    assert len(robot.steps()) == 2


def first_step(start_bridge: StartBridge, open_client: OpenClient) -> int:
    with answering(open_client(), FIRST):
        robot = start_bridge()
        standing = Standing(robot)

        def steps() -> list[Scan]:
            standing.scan()  # it may still be without a map
            return robot.steps()

        wait_until(lambda: bool(steps()))
        return robot.steps()[0].step
