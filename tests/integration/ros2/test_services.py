import time
from typing import Any

import numpy as np
import pytest

from clustermcl.protocol.advice import Advice, Way
from clustermcl.recordings.rigid import IDENTITY
from clustermcl.ros2 import message_types as types
from clustermcl.ros2.message_types import new, request_of, type_hash
from clustermcl.ros2.messages_out import pose_stamped
from clustermcl.ros2.topics import ADVICE, DIAGNOSTICS, HYPOTHESES, STATE
from clustermcl.ros2.wire import attachment, data_key
from tests.integration.ros2.conftest import (
    ACTIVE,
    Active,
    OpenRobot,
    OpenSession,
    OpenSystem,
    StartBridge,
)
from tests.integration.waiting import wait_until

pytestmark = pytest.mark.usefixtures("router")

COVARIANCE = (0.25, 0.01, 0.0, 0.01, 0.09, 0.0, 0.0, 0.0, 0.07)


def test_commands_of_ros_reach_the_system(active: Active) -> None:
    robot, system = active
    robot.call("reinitialize_global_localization", types.EMPTY)
    robot.call("request_nomotion_update", types.EMPTY)
    reported = pose_stamped((1.0, 2.0, 0.5), COVARIANCE, 0, "map")
    request = new(request_of(types.SET_INITIAL_POSE), pose=reported)
    robot.call("set_initial_pose", types.SET_INITIAL_POSE, request)
    wait_until(lambda: len(system.commands) == 3)
    commands_by_key = dict(system.commands)
    assert set(commands_by_key) == {"command/relocalize", "command/update", "command/set_pose"}
    command = commands_by_key["command/set_pose"]
    assert command["pose"] == pytest.approx([1.0, 2.0, 0.5])
    assert command["covariance"] == pytest.approx(COVARIANCE)
    robot.put_initial_pose((4.0, 2.0, 0.5))
    wait_until(lambda: len(system.commands) == 4)


def test_a_command_before_the_system_answers_reaches_it(
    open_robot: OpenRobot, open_system: OpenSystem, start_bridge: StartBridge
) -> None:
    robot = open_robot()
    robot.put_mounts(("laser", IDENTITY))
    start_bridge(ACTIVE)
    robot.call("request_nomotion_update", types.EMPTY)
    system = open_system()
    wait_until(lambda: system.commands)
    assert system.commands[0][0] == "command/update"


def test_advice_is_published_as_a_path_in_the_odometry_frame(active: Active) -> None:
    robot, system = active
    paths = robot.listen(ADVICE)
    robot.call("/amcl/advise", types.EMPTY)
    wait_until(lambda: paths)
    assert len(paths[-1].poses) == 0
    way = Way(
        poses=((0.0, 0.0, 0.0), (1.0, 0.5, 0.0)), length_m=1.1, turn_rad=0.0, information=0.5,
        sure_probability=0.3, sight_bearing_rad=0.0, sight_ranges_m=(1.0, 2.0),
    )  # fmt: skip
    system.advice = Advice(
        sender="coordinator", step=3, stamp_ns=7_000_000_000, clusters=(1, 2), ways=(way,),
        odom_from_robot=(2.0, 3.0, np.pi / 2.0), places=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
    )  # fmt: skip
    robot.call("/amcl/advise", types.EMPTY)
    wait_until(lambda: len(paths[-1].poses) == 2)
    path = paths[-1]
    assert (path.header.frame_id, path.header.stamp.sec) == ("odom", 7)
    end = path.poses[1].pose.position
    assert (end.x, end.y) == pytest.approx((1.5, 4.0))


def test_the_service_is_localized_answers_the_state(active: Active) -> None:
    robot, system = active

    def answer() -> Any:
        return robot.call("/amcl/is_localized", types.TRIGGER)

    assert not answer().success
    robot.stand_until(lambda: system.lasers)
    states = robot.listen(STATE)
    system.believe(system.lasers[-1].stamp_ns, (1, 0.95, (1.0, 2.0, 0.0)), state="localized")
    wait_until(lambda: answer().success)
    assert answer().message == "localized, fresh, probability 0.950"
    assert states[-1].data == "localized"
    system.freshness = "stale"
    wait_until(lambda: not answer().success)


def test_diagnostics_show_the_state_and_refused_messages(
    open_robot: OpenRobot, open_system: OpenSystem, start_bridge: StartBridge
) -> None:
    robot = open_robot()
    robot.put_mounts(("laser", IDENTITY))
    start_bridge(ACTIVE)
    reported = robot.listen(DIAGNOSTICS)
    wait_until(lambda: reported and reported[-1].status[0].level == 2)  # no service is there yet
    assert reported[-1].status[0].message == "searching, unreachable"
    system = open_system()
    robot.stand_until(lambda: system.lasers)
    markers = robot.listen(HYPOTHESES)
    places = [(1, 0.6, (1.0, 2.0, 0.0)), (2, 0.4, (4.0, 2.0, 0.0))]
    system.believe(system.lasers[-1].stamp_ns, *places)
    robot.put_initial_pose((0.0, 0.0, 0.0), frame="odom")
    wait_until(
        lambda: reported[-1].status[0].level == 0 and "initial pose refused" in values(reported[-1])
    )
    assert reported[-1].status[0].name == "amcl: localization"
    found = values(reported[-1])
    assert (found["places"], found["probability"]) == ("2", "0.600")
    assert found["initial pose refused"] == "1"
    assert len(markers[-1].markers) == 7


def values(message: Any) -> dict[str, str]:
    return {one.key: one.value for one in message.status[0].values}


def test_a_malformed_service_call_gets_no_answer_and_the_next_one_does(
    active: Active, open_robot_session: OpenSession
) -> None:
    (robot, _), foreign = active, open_robot_session()
    kind = types.SET_PARAMETERS
    key = data_key(0, "/amcl/set_parameters", kind, type_hash(kind, humble=False))
    good = attachment(1, time.time_ns(), bytes(16))
    for payload, attached in ((b"\xff" * 9, good), (b"", good), (b"\0\1\0\0\0\0\0\0", b"short")):
        replies = foreign.get(key, payload=payload, attachment=attached, timeout=1.0)
        assert [reply.ok for reply in replies] == []
    assert robot.call("/amcl/set_parameters", kind).results == []
