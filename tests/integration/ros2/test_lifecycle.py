"""A double of nav2's lifecycle manager: what it asks, in its order, and the bond it waits for."""

import json
import os
import signal
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from clustermcl.recordings.rigid import IDENTITY
from clustermcl.ros2 import message_types as types
from clustermcl.ros2.message_types import new, request_of
from clustermcl.ros2.topics import AMCL_POSE, BOND, TRANSITION_EVENT
from clustermcl.runtime.ros2_settings import Ros2Settings
from tests.integration.ros2.conftest import ACTIVE, Active, OpenRobot, OpenSystem, StartBridge
from tests.integration.ros2.robot import RosRobot
from tests.integration.waiting import stretched_s, wait_until

pytestmark = pytest.mark.usefixtures("router")

CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = 1, 2, 3, 4
BOND_TIMEOUT_S = 4.0
"""Nav2's bond_timeout."""
BOND_WITHIN_S = BOND_TIMEOUT_S / 2.0


class Manager:
    def __init__(self, robot: RosRobot) -> None:
        self._robot = robot
        self.bonds: list[Any] = robot.listen(BOND)
        self.bond_at_s = robot.received_at_s[BOND.name]
        self.events: list[Any] = robot.listen(TRANSITION_EVENT)

    def state(self) -> str:
        label: str = self._robot.call("/amcl/get_state", types.GET_STATE).current_state.label
        return label

    def change(self, number: int, label: str = "") -> bool:
        transition = new("lifecycle_msgs/msg/Transition", id=number, label=label)
        request = new(request_of(types.CHANGE_STATE), transition=transition)
        success: bool = self._robot.call("/amcl/change_state", types.CHANGE_STATE, request).success
        return success


def test_the_lifecycle_manager_starts_pauses_resumes_and_resets_the_node(
    open_robot: OpenRobot, open_system: OpenSystem, start_bridge: StartBridge
) -> None:
    robot, system = open_robot(), open_system()
    robot.put_mounts(("laser", IDENTITY))
    start_bridge()
    manager = Manager(robot)
    assert manager.state() == "unconfigured"
    assert not manager.change(ACTIVATE)
    assert manager.change(CONFIGURE)
    assert manager.state() == "inactive"
    assert manager.bonds == []
    asked_s = time.monotonic()
    assert manager.change(ACTIVATE)
    assert manager.state() == "active"
    wait_until(lambda: manager.bonds)
    assert manager.bond_at_s[0] - asked_s < stretched_s(BOND_WITHIN_S)
    first = manager.bonds[0]
    assert (first.id, first.active, first.heartbeat_timeout) == ("amcl", True, 4.0)
    assert first.heartbeat_period == pytest.approx(0.1)
    robot.stand_until(lambda: system.lasers)

    assert manager.change(DEACTIVATE)  # pause
    wait_until(lambda: not manager.bonds[-1].active)
    received = len(system.lasers)
    paused_ns = time.time_ns()
    for number in range(5):
        robot.put_scan(system.lasers[-1], stamp_ns=paused_ns + number)
    robot.put_odometry(paused_ns + 5, (0.0, 0.0, 0.0))
    assert manager.state() == "inactive"  # asked after them, and answered after them
    assert not any(one.stamp_ns >= paused_ns for one in system.lasers)

    assert manager.change(ACTIVATE)  # resume
    wait_until(lambda: manager.bonds[-1].active)
    assert manager.bonds[-1].instance_id != first.instance_id
    robot.stand_until(lambda: len(system.lasers) > received)

    assert manager.change(DEACTIVATE)  # reset
    assert manager.change(CLEANUP)
    assert manager.state() == "unconfigured"
    assert manager.change(CONFIGURE)
    assert manager.change(ACTIVATE)
    assert manager.state() == "active"

    def asked() -> list[str]:
        labels = [event.transition.label for event in list(manager.events)]
        return [label for label in labels if label != "transition_success"]

    expected = [
        *("configure", "activate", "deactivate", "activate"),
        *("deactivate", "cleanup", "configure", "activate"),
    ]
    wait_until(lambda: len(asked()) >= len(expected))
    assert asked() == expected
    assert manager.events[0].start_state.label == "unconfigured"
    assert manager.events[1].goal_state.label == "inactive"


def test_the_transition_graph_is_served(active: Active) -> None:
    robot, _ = active
    states = robot.call("/amcl/get_available_states", types.GET_AVAILABLE_STATES)
    assert [one.id for one in states.available_states] == [0, 1, 2, 3, 4, 10, 11, 12, 13, 14, 15]
    kind = types.GET_AVAILABLE_TRANSITIONS
    available = robot.call("/amcl/get_available_transitions", kind).available_transitions
    assert [one.transition.label for one in available] == ["deactivate", "shutdown"]
    graph = robot.call("/amcl/get_transition_graph", kind).available_transitions
    assert ("configure", "unconfigured", "configuring") in [
        (one.transition.label, one.start_state.label, one.goal_state.label) for one in graph
    ]


def test_the_bond_continues_without_a_system_and_under_a_flood(
    open_robot: OpenRobot, open_system: OpenSystem, start_bridge: StartBridge
) -> None:
    robot = open_robot()
    robot.put_mounts(("laser", IDENTITY))
    start_bridge(ACTIVE)
    manager = Manager(robot)
    wait_until(lambda: len(manager.bonds) >= 3)  # without any system
    system = open_system()
    robot.stand_until(lambda: system.lasers)
    poses = robot.listen(AMCL_POSE)
    stamp_ns = system.lasers[-1].stamp_ns
    places = [(number, 0.001, (float(number), 0.0, 0.0)) for number in range(200)]

    def is_flooded() -> bool:
        """A coordinator publishes faster than the bridge can: surplus messages are dropped."""
        system.believe(stamp_ns, *places, state="localized")
        return len(poses) >= 30

    system.put("belief", b"\xff" * 100_000)
    wait_until(is_flooded)
    count = len(manager.bonds)
    wait_until(lambda: len(manager.bonds) >= count + 5)
    gaps_s = [after - before for before, after in pairwise(manager.bond_at_s)]
    assert max(gaps_s) < min(stretched_s(1.0), BOND_TIMEOUT_S)
    assert all(bond.active for bond in manager.bonds)


def test_a_killed_bridge_continues_in_its_state_with_the_same_bond(
    open_robot: OpenRobot, open_system: OpenSystem, start_bridge: StartBridge, tmp_path: Path
) -> None:
    robot, system = open_robot(), open_system()
    robot.put_mounts(("laser", IDENTITY))
    bridge = start_bridge(Ros2Settings(set_initial_pose=True))
    manager, poses = Manager(robot), robot.listen(AMCL_POSE)
    assert manager.change(CONFIGURE)
    assert manager.change(ACTIVATE)
    robot.stand_until(lambda: system.lasers)
    stamp_ns = system.lasers[-1].stamp_ns
    system.believe(stamp_ns, (5, 0.95, (1.0, 2.0, 0.0)), state="localized")
    wait_until(lambda: poses)
    (kept,) = tmp_path.glob("ros2-*.json")
    wait_until(lambda: json.loads(kept.read_text())["held"] == 5)  # kept just after the pose
    del system.commands[:], poses[:]
    bridge.kill()
    killed_s, count = time.monotonic(), len(manager.bonds)
    start_bridge(Ros2Settings(set_initial_pose=True))
    wait_until(lambda: len(manager.bonds) > count)
    assert manager.bond_at_s[count] - killed_s < min(stretched_s(3.0), BOND_TIMEOUT_S)
    assert manager.bonds[count].instance_id == manager.bonds[0].instance_id
    assert manager.state() == "active"
    wait_until(lambda: system.commands)
    assert [key for key, _ in system.commands] == ["command/update"]  # and no initial pose
    received = len(system.lasers)
    robot.stand_until(lambda: len(system.lasers) > received)
    places = [(4, 0.6, (9.0, 9.0, 0.0)), (5, 0.4, (1.0, 2.0, 0.0))]

    def published() -> bool:  # some are lost while bridge and robot find each other
        system.believe(system.lasers[-1].stamp_ns, *places, state="ambiguous")
        return bool(poses)

    robot.stand_until(published)  # each scan has a new stamp: a belief counts once
    assert poses[-1].pose.pose.position.y == 2.0  # the place that it held


@pytest.mark.parametrize("is_late", [False, True])
def test_a_stopped_or_late_bridge_starts_unconfigured(
    open_robot: OpenRobot, start_bridge: StartBridge, tmp_path: Path, *, is_late: bool
) -> None:
    robot = open_robot()
    robot.put_mounts()
    bridge, manager = start_bridge(), Manager(robot)
    assert manager.change(CONFIGURE)
    wait_until(lambda: list(tmp_path.glob("ros2-*.json")))
    bridge.send_signal(signal.SIGKILL if is_late else signal.SIGTERM)
    bridge.wait()
    kept = list(tmp_path.glob("ros2-*.json"))
    assert len(kept) == is_late
    for file in kept:
        long_ago_s = time.time() - BOND_TIMEOUT_S
        os.utime(file, (long_ago_s, long_ago_s))
    start_bridge()
    assert manager.state() == "unconfigured"


@pytest.mark.parametrize("content", ['{"state":99,"bond":"","held":null}', "[" * 5000])
def test_a_damaged_restart_file_is_reported_and_not_used(
    open_robot: OpenRobot, start_bridge: StartBridge, tmp_path: Path, content: str
) -> None:
    open_robot().put_mounts()
    (tmp_path / "ros2-robot-0%2Famcl.json").write_text(content)
    bridge = start_bridge(ACTIVE, expect="ros2-robot-0%2Famcl.json is not used: ")
    bridge.wait_for("is running in ROS domain")
    assert bridge.is_running()
