"""The lifecycle and the bond, as nav2's lifecycle manager uses them."""

import signal

import pytest

pytest.importorskip("rclpy", reason="no rclpy: see .ci/run")

from lifecycle_msgs.msg import TransitionEvent

from tests.integration.ros.conftest import StartDrive
from tests.integration.ros.robot import ACTIVATE, CLEANUP, CONFIGURE, DEACTIVATE, Bond
from tests.integration.waiting import wait_until

SHUTDOWN = {"unconfigured": 5, "inactive": 6, "active": 7}


def test_every_transition_is_made_or_refused_and_the_node_lives_on(start_drive: StartDrive) -> None:
    drive = start_drive(active=False)
    robot, bond = drive.robot, Bond(drive.robot)
    events = robot.listen("amcl/transition_event", TransitionEvent)
    assert robot.state() == "unconfigured"
    for refused in (ACTIVATE, DEACTIVATE, CLEANUP, 99):
        assert not robot.change_state(refused)
    assert robot.state() == "unconfigured"
    assert robot.change_state(CONFIGURE)
    assert robot.state() == "inactive"
    assert not robot.change_state(CONFIGURE)
    assert not bond.heard
    assert robot.change_state(ACTIVATE)
    assert robot.state() == "active"
    for refused in (CONFIGURE, ACTIVATE, CLEANUP):
        assert not robot.change_state(refused)
    wait_until(lambda: len(bond.heard) > 20)
    status = bond.heard[-1][1]
    assert (status.id, status.active, status.heartbeat_timeout) == ("amcl", True, 4.0)
    assert len({one.instance_id for _, one in bond.heard}) == 1
    assert robot.change_state(DEACTIVATE)
    wait_until(lambda: not bond.heard[-1][1].active)
    assert robot.change_state(CLEANUP)
    assert robot.state() == "unconfigured"
    robot.activate()
    wait_until(bond.is_alive)
    assert bond.heard[-1][1].instance_id != status.instance_id
    assert robot.change_state(SHUTDOWN["active"])
    assert robot.state() == "finalized"
    wait_until(lambda: not bond.is_alive())
    assert not robot.change_state(CONFIGURE)
    wait_until(lambda: events and events[-1].goal_state.label == "finalized")
    drive.node.send_signal(signal.SIGTERM)
    assert drive.node.wait() == 0
