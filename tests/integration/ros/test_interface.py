"""AMCL's interface, row by row: names, types and quality of service in ROS's own graph."""

import time

import pytest

pytest.importorskip("rclpy", reason="no rclpy: see .ci/run")

from nav2_msgs.srv import SetInitialPose
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64
from std_srvs.srv import Empty, Trigger

from clustermcl.ros2.parameter_table import PARAMETERS
from tests.integration.ros.conftest import StartDrive
from tests.integration.ros.robot import LATCHED, Robot, pose_message
from tests.integration.waiting import wait_until

RELIABLE, BEST_EFFORT, ALL_LATCHED = "reliable", "best effort", "latched"
PUBLISHED = {
    "/amcl_pose": ("geometry_msgs/msg/PoseWithCovarianceStamped", ALL_LATCHED),
    "/particle_cloud": ("nav2_msgs/msg/ParticleCloud", BEST_EFFORT),
    "/tf": ("tf2_msgs/msg/TFMessage", RELIABLE),
    "/bond": ("bond/msg/Status", RELIABLE),
    "/diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", RELIABLE),
    "/amcl/transition_event": ("lifecycle_msgs/msg/TransitionEvent", RELIABLE),
    "/amcl/hypotheses": ("visualization_msgs/msg/MarkerArray", ALL_LATCHED),
    "/amcl/hypotheses/detection": ("vision_msgs/msg/Detection3D", ALL_LATCHED),
    "/amcl/advice": ("nav_msgs/msg/Path", ALL_LATCHED),
    "/amcl/state": ("std_msgs/msg/String", ALL_LATCHED),
    "/amcl/probability": ("std_msgs/msg/Float64", ALL_LATCHED),
}
READ = {
    "/scan": ("sensor_msgs/msg/LaserScan", BEST_EFFORT),
    "/map": ("nav_msgs/msg/OccupancyGrid", ALL_LATCHED),
    "/initialpose": ("geometry_msgs/msg/PoseWithCovarianceStamped", RELIABLE),
    "/tf": ("tf2_msgs/msg/TFMessage", RELIABLE),
    "/tf_static": ("tf2_msgs/msg/TFMessage", ALL_LATCHED),
}
SERVED = {
    "/reinitialize_global_localization": "std_srvs/srv/Empty",
    "/request_nomotion_update": "std_srvs/srv/Empty",
    "/set_initial_pose": "nav2_msgs/srv/SetInitialPose",
    "/amcl/advise": "std_srvs/srv/Empty",
    "/amcl/is_localized": "std_srvs/srv/Trigger",
    "/amcl/change_state": "lifecycle_msgs/srv/ChangeState",
    "/amcl/get_state": "lifecycle_msgs/srv/GetState",
    "/amcl/get_parameters": "rcl_interfaces/srv/GetParameters",
    "/amcl/set_parameters": "rcl_interfaces/srv/SetParameters",
}


def endpoints(robot: Robot, *, reads: bool) -> dict[str, tuple[str, str]]:
    """Types and qualities of the topics of AMCL's node."""
    node = robot.node
    if reads:
        named = node.get_subscriber_names_and_types_by_node("amcl", "/")
        about = node.get_subscriptions_info_by_topic
    else:
        named = node.get_publisher_names_and_types_by_node("amcl", "/")
        about = node.get_publishers_info_by_topic
    found = {}
    for topic, [ros_type] in named:
        qualities = [one.qos_profile for one in about(topic) if one.node_name == "amcl"]
        assert len(qualities) == 1, topic
        found[topic] = (ros_type, quality(qualities[0]))
    return found


def quality(qos: QoSProfile) -> str:
    if qos.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        return ALL_LATCHED
    return RELIABLE if qos.reliability == ReliabilityPolicy.RELIABLE else BEST_EFFORT


def test_the_graph_has_amcls_topics_services_and_parameters(start_drive: StartDrive) -> None:
    robot = start_drive(active=False).robot
    wait_until(lambda: ("amcl", "/") in robot.node.get_node_names_and_namespaces())
    for reads, expected in ((False, PUBLISHED), (True, READ)):
        wait_until(lambda r=reads, e=expected: endpoints(robot, reads=r).keys() >= e.keys())
        assert endpoints(robot, reads=reads).items() >= expected.items()
    served = robot.node.get_service_names_and_types_by_node("amcl", "/")
    assert {name: kind for name, [kind] in served}.items() >= SERVED.items()
    values = robot.parameters(*PARAMETERS)
    for (name, parameter), value in zip(PARAMETERS.items(), values, strict=True):
        assert type(value) is type(parameter.default), name


def test_the_services_do_what_they_say(start_drive: StartDrive) -> None:
    drive = start_drive()
    robot, states = drive.robot, drive.states
    probable = robot.listen("amcl/probability", Float64, LATCHED)
    logged = robot.listen("/rosout", Log, LATCHED)
    assert not robot.call("amcl/is_localized", Trigger).success
    [stamp] = drive.drive(1)
    robot.call("set_initial_pose", SetInitialPose, pose=pose_message(drive.truth[stamp]))
    drive.drive_until(lambda: robot.call("amcl/is_localized", Trigger).success, 100)
    assert robot.call("amcl/is_localized", Trigger).message.startswith("localized, ")

    # The robot stands: the gate lets no scan pass, unless a step is asked for.
    tick = next(iter(drive.simulation))
    drive.step(tick, 2.0)
    count = len(probable)
    robot.call("request_nomotion_update", Empty)
    while len(probable) == count:  # within the test's own time
        drive.step(tick, 0.2)
        time.sleep(0.1)  # the transform is known already: a flood keeps the node from its work

    robot.call("reinitialize_global_localization", Empty)
    drive.drive_until(lambda: states[-1].data != "localized")
    assert any(one.name == "amcl" for one in logged)  # the last line before or since
