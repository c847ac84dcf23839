import time

import pytest

from ros2_bridge import message_types as types
from ros2_bridge.message_types import type_hash
from ros2_bridge.wire import attachment, data_key
from tests.integration.ros2.conftest import ACTIVE, OpenRobot, OpenSession, StartBridge

pytestmark = pytest.mark.usefixtures("router")


def test_a_malformed_service_call_gets_no_answer_and_the_next_one_does(
    open_robot: OpenRobot, open_robot_session: OpenSession, start_bridge: StartBridge
) -> None:
    robot, foreign = open_robot(), open_robot_session()
    robot.put_mounts()
    start_bridge(ACTIVE)
    kind = types.SET_PARAMETERS
    key = data_key(0, "/amcl/set_parameters", kind, type_hash(kind, humble=False))
    good = attachment(1, time.time_ns(), bytes(16))
    for payload, attached in ((b"\xff" * 9, good), (b"", good), (b"\0\1\0\0\0\0\0\0", b"short")):
        replies = foreign.get(key, payload=payload, attachment=attached, timeout=1.0)
        assert [reply.ok for reply in replies] == []
    assert robot.call("/amcl/set_parameters", kind).results == []
