"""AMCL's interface, row by row: names, types and quality of service in ROS's own graph."""

import pytest

pytest.importorskip("rclpy", reason="no rclpy: see .ci/run")

from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64, String
from std_srvs.srv import Empty, Trigger

from clustermcl.ros2.parameter_table import PARAMETERS
from tests.integration.ros.conftest import OpenRobot, StartNode
from tests.integration.ros.robot import LATCHED, Drive, Robot
from tests.integration.waiting import wait_until

RELIABLE, BEST_EFFORT, ALL_LATCHED = "reliable", "best effort", "latched"
PUBLISHED = {
    "/amcl_pose": ("geometry_msgs/msg/PoseWithCovarianceStamped", ALL_LATCHED),
    "/particle_cloud": ("nav2_msgs/msg/ParticleCloud", BEST_EFFORT),
    "/tf": ("tf2_msgs/msg/TFMessage", RELIABLE),
    "/bond": ("bond/msg/Status", RELIABLE),
    "/diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", RELIABLE),
    "/rosout": ("rcl_interfaces/msg/Log", ALL_LATCHED),
    "/parameter_events": ("rcl_interfaces/msg/ParameterEvent", RELIABLE),
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
    "/amcl/get_available_states": "lifecycle_msgs/srv/GetAvailableStates",
    "/amcl/get_available_transitions": "lifecycle_msgs/srv/GetAvailableTransitions",
    "/amcl/get_transition_graph": "lifecycle_msgs/srv/GetAvailableTransitions",
    "/amcl/get_parameters": "rcl_interfaces/srv/GetParameters",
    "/amcl/get_parameter_types": "rcl_interfaces/srv/GetParameterTypes",
    "/amcl/set_parameters": "rcl_interfaces/srv/SetParameters",
    "/amcl/set_parameters_atomically": "rcl_interfaces/srv/SetParametersAtomically",
    "/amcl/list_parameters": "rcl_interfaces/srv/ListParameters",
    "/amcl/describe_parameters": "rcl_interfaces/srv/DescribeParameters",
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


def test_the_graph_has_amcls_topics_and_services(
    start_node: StartNode, open_robot: OpenRobot
) -> None:
    start_node()
    robot = open_robot()
    node = robot.node
    wait_until(lambda: ("amcl", "/") in node.get_node_names_and_namespaces())
    wait_until(lambda: endpoints(robot, reads=False).keys() >= PUBLISHED.keys())
    assert endpoints(robot, reads=False).items() >= PUBLISHED.items()
    wait_until(lambda: endpoints(robot, reads=True).keys() >= READ.keys())
    assert endpoints(robot, reads=True).items() >= READ.items()
    served = {name: kind for name, [kind] in node.get_service_names_and_types_by_node("amcl", "/")}
    assert served.items() >= SERVED.items()


def test_the_services_do_what_they_say(start_node: StartNode, open_robot: OpenRobot) -> None:
    start_node(parameters={"autostart_node": True})
    robot = open_robot()
    drive = Drive(robot)
    probable = robot.listen("amcl/probability", Float64, LATCHED)
    states = robot.listen("amcl/state", String, LATCHED)
    logged = robot.listen("/rosout", Log, LATCHED)
    drive.begin()
    assert not robot.call("amcl/is_localized", Trigger).success
    [first] = drive.drive(1)
    robot.put_initial_pose(drive.truth[first])
    drive.drive_until(lambda: states and states[-1].data == "localized")
    drive.drive_until(lambda: robot.call("amcl/is_localized", Trigger).success, 100)
    answer = robot.call("amcl/is_localized", Trigger)
    assert answer.message.startswith("localized, ")

    # The robot stands: the gate lets no scan pass, unless a step is asked for.
    tick = next(iter(drive.simulation))
    drive.step(tick, 2.0)
    count = len(probable)
    robot.call("request_nomotion_update", Empty)
    while len(probable) == count:  # within the test's own time
        drive.step(tick, 0.2)

    robot.call("reinitialize_global_localization", Empty)
    drive.drive_until(lambda: states[-1].data != "localized")
    assert any(one.name == "amcl" for one in logged)  # the last line before or since


def test_the_parameters_are_amcls(start_node: StartNode, open_robot: OpenRobot) -> None:
    start_node()
    robot = open_robot()
    values = robot.parameters(*PARAMETERS)
    for (name, parameter), value in zip(PARAMETERS.items(), values, strict=True):
        assert type(value) is type(parameter.default), name
