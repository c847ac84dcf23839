"""Parameters: from files as ROS reads them, and set while the robot drives."""

import pytest

pytest.importorskip("rclpy", reason="no rclpy: see .ci/run")

from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter

from tests.integration.ros.conftest import OpenRobot, StartDrive, StartNode
from tests.integration.waiting import wait_until

NAV2_FILE = """
/**:
  ros__parameters:
    use_sim_time: false
    alpha1: 0.1
amcl:
  ros__parameters:
    alpha1: 0.3
    alpha2: 1              # ROS has this as an integer
    max_beams: 30
    max_particles: 5000
    scan_topic: front/scan
    robot_model_type: "nav2_amcl::DifferentialMotionModel"
    no_such_parameter: 1
bt_navigator:
  ros__parameters:
    alpha1: 9.0
"""


def test_a_file_of_nav2_is_read_as_ros_reads_it(
    start_node: StartNode, open_robot: OpenRobot
) -> None:
    node = start_node("-p", "alpha3:=0.5", "-r", "map:=/plan", file=NAV2_FILE)
    robot = open_robot()
    names = ("alpha1", "alpha2", "alpha3", "max_beams", "max_particles", "scan_topic")
    assert robot.parameters(*names) == [0.3, 1.0, 0.5, 30, 5000, "front/scan"]
    read = robot.node
    wait_until(lambda: read.count_subscribers("front/scan") and read.count_subscribers("/plan"))
    assert read.count_subscribers("scan") == read.count_subscribers("map") == 0
    for warned in ("max_particles has no effect", "no_such_parameter has no effect"):
        assert warned in node.err


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({"alpha1": "much"}, "alpha1 = 'much': nav2 expects a number"),
        ({"scan_topic": "front scan"}, "Invalid topic name: topic name must not contain"),
        ({"scan_topic": ""}, "scan_topic = '': name a topic of scans"),
        ({"engine": "steam"}, "engine = 'steam'"),
        ({"belief.particles": -5}, "belief.particles"),
    ],
)
def test_a_bad_value_ends_the_start_with_one_line(
    start_node: StartNode, parameters: dict[str, object], problem: str
) -> None:
    node = start_node(parameters=parameters, expect="")
    assert node.wait() == 2
    assert problem in node.err
    assert "Traceback" not in node.err


def test_parameters_are_set_while_the_node_runs(start_drive: StartDrive) -> None:
    robot = start_drive().robot
    events = robot.listen("/parameter_events", ParameterEvent)
    [result] = robot.set_parameters(update_min_d=0.4)
    assert result.successful, result.reason
    assert robot.parameters("update_min_d") == [0.4]
    wait_until(lambda: any(p.name == "update_min_d" for e in events for p in e.changed_parameters))
    good, bad, fixed = robot.set_parameters(sigma_hit=0.1, z_hit=-1.0, odom_frame_id="wheels")
    assert (good.successful, bad.successful, fixed.successful) == (True, False, False)
    assert bad.reason
    assert fixed.reason
    assert robot.parameters("sigma_hit", "odom_frame_id") == [0.1, "odom"]
    together = [Parameter("alpha1", value=0.2), Parameter("z_rand", value=-0.5)]
    asked = [one.to_parameter_msg() for one in together]
    before = robot.parameters("alpha1")
    response = robot.call(
        "amcl/set_parameters_atomically", SetParametersAtomically, parameters=asked
    )
    assert not response.result.successful
    assert robot.parameters("alpha1") == before
