import signal
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest
import zenoh

from clustermcl.recordings.rigid import IDENTITY
from clustermcl.ros2.topics import AMCL_POSE, BOND
from clustermcl.ros2.wire import HUMBLE_HASH
from clustermcl.runtime.ros2_settings import Ros2Settings
from tests.integration.processes import RunningProcess
from tests.integration.ros2.conftest import ACTIVE, OpenRobot, OpenSession, OpenSystem, StartBridge
from tests.integration.waiting import stretched_s, wait_until

SENT = {
    "MP /amcl_pose geometry_msgs::msg::dds_::PoseWithCovarianceStamped_ :1:,1:,:,:,,",
    "MP /particle_cloud nav2_msgs::msg::dds_::ParticleCloud_ 2::,5:,:,:,,",
    "MP /tf tf2_msgs::msg::dds_::TFMessage_ ::,100:,:,:,,",
    "MP /diagnostics diagnostic_msgs::msg::dds_::DiagnosticArray_ ::,10:,:,:,,",
    "MP /bond bond::msg::dds_::Status_ ::,5:,:,:,,",
    "MP /parameter_events rcl_interfaces::msg::dds_::ParameterEvent_ ::,1000:,:,:,,",
    "MP /rosout rcl_interfaces::msg::dds_::Log_ :1:,1000:,:,:,,",
    "MP /amcl/transition_event lifecycle_msgs::msg::dds_::TransitionEvent_ ::,10:,:,:,,",
    "MP /amcl/hypotheses visualization_msgs::msg::dds_::MarkerArray_ :1:,1:,:,:,,",
    "MP /amcl/hypotheses/detection vision_msgs::msg::dds_::Detection3D_ :1:,1:,:,:,,",
    "MP /amcl/advice nav_msgs::msg::dds_::Path_ :1:,1:,:,:,,",
    "MP /amcl/state std_msgs::msg::dds_::String_ :1:,1:,:,:,,",
    "MP /amcl/probability std_msgs::msg::dds_::Float64_ :1:,1:,:,:,,",
}
READ = {
    "MS /scan sensor_msgs::msg::dds_::LaserScan_ 2::,5:,:,:,,",
    "MS /map nav_msgs::msg::dds_::OccupancyGrid_ :1:,1:,:,:,,",
    "MS /tf tf2_msgs::msg::dds_::TFMessage_ ::,100:,:,:,,",
    "MS /tf_static tf2_msgs::msg::dds_::TFMessage_ :1:,100:,:,:,,",
    "MS /initialpose geometry_msgs::msg::dds_::PoseWithCovarianceStamped_ ::,10:,:,:,,",
}
SERVED = {
    "/reinitialize_global_localization std_srvs::srv::dds_::Empty_",
    "/request_nomotion_update std_srvs::srv::dds_::Empty_",
    "/set_initial_pose nav2_msgs::srv::dds_::SetInitialPose_",
    "/amcl/advise std_srvs::srv::dds_::Empty_",
    "/amcl/is_localized std_srvs::srv::dds_::Trigger_",
    "/amcl/change_state lifecycle_msgs::srv::dds_::ChangeState_",
    "/amcl/get_state lifecycle_msgs::srv::dds_::GetState_",
    "/amcl/get_available_states lifecycle_msgs::srv::dds_::GetAvailableStates_",
    "/amcl/get_available_transitions lifecycle_msgs::srv::dds_::GetAvailableTransitions_",
    "/amcl/get_transition_graph lifecycle_msgs::srv::dds_::GetAvailableTransitions_",
}
PARAMETERS_SERVED = {
    "/amcl/get_parameters rcl_interfaces::srv::dds_::GetParameters_",
    "/amcl/set_parameters rcl_interfaces::srv::dds_::SetParameters_",
    "/amcl/set_parameters_atomically rcl_interfaces::srv::dds_::SetParametersAtomically_",
    "/amcl/list_parameters rcl_interfaces::srv::dds_::ListParameters_",
    "/amcl/describe_parameters rcl_interfaces::srv::dds_::DescribeParameters_",
    "/amcl/get_parameter_types rcl_interfaces::srv::dds_::GetParameterTypes_",
}
ENDPOINTS = SENT | READ | {f"SS {service} ::,10:,:,:,," for service in SERVED}
ENDPOINTS |= {f"SS {service} ::,1000:,:,:,," for service in PARAMETERS_SERVED}


class Graph:
    """All tokens of a domain, as another session sees them."""

    def __init__(self, session: zenoh.Session, domain_id: int = 0) -> None:
        self.tokens: set[str] = set()
        self.gone_at_s: list[float] = []
        session.liveliness().declare_subscriber(
            f"@ros2_lv/{domain_id}/**", self._on_token, history=True
        )

    def _on_token(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            self.tokens.add(str(sample.key_expr))
        else:
            self.tokens.discard(str(sample.key_expr))
            self.gone_at_s.append(time.monotonic())

    def of(self, node: str = "amcl", namespace: str = "%") -> list[list[str]]:
        split = (token.split("/") for token in list(self.tokens))
        return [parts for parts in split if parts[7:9] == [namespace, node]]

    def endpoints(self, node: str = "amcl", namespace: str = "%") -> set[str]:
        """Kind, topic, type and quality of each endpoint of a node."""
        return {
            f"{parts[5]} {parts[9].replace('%', '/')} {parts[10]} {parts[12]}"
            for parts in self.of(node, namespace)
            if parts[5] != "NN"
        }


@pytest.mark.usefixtures("router")
def test_another_session_sees_the_topics_and_services_of_amcl_until_the_bridge_is_killed(
    open_robot_session: OpenSession, open_robot: OpenRobot, start_bridge: StartBridge
) -> None:
    graph, robot = Graph(open_robot_session()), open_robot()
    robot.put_mounts()
    bridge = start_bridge()
    wait_until(lambda: len(graph.of()) == len(ENDPOINTS) + 1)
    assert graph.endpoints() == ENDPOINTS
    (node,) = (parts for parts in graph.of() if parts[5] == "NN")
    assert node[3] == node[4]
    numbers = [parts[4] for parts in graph.of()]
    assert len(set(numbers)) == len(numbers)
    assert {parts[2] for parts in graph.of()} == {node[2]}
    assert all(parts[11].startswith("RIHS01_") for parts in graph.of() if parts[5] != "NN")

    killed_s = time.monotonic()
    bridge.send_signal(signal.SIGKILL)
    wait_until(lambda: not graph.of())
    assert graph.gone_at_s[-1] - killed_s < stretched_s(0.1)
    start_bridge()
    wait_until(lambda: graph.endpoints() == ENDPOINTS)


def test_transform_and_bond_go_on_without_a_router_which_gives_the_node_to_others_again(
    start_router: Callable[[], RunningProcess],
    open_robot_session: OpenSession,
    open_robot: OpenRobot,
    open_system: OpenSystem,
    start_bridge: StartBridge,
) -> None:
    router = start_router()
    graph, robot, system = Graph(open_robot_session()), open_robot(), open_system()
    nav2 = open_robot(name="nav2")
    robot.put_mounts(("laser", IDENTITY))
    start_bridge(ACTIVE)
    robot.stand_until(lambda: system.lasers)
    nav2.listen(BOND)
    system.believe(system.lasers[-1].stamp_ns, (1, 0.95, (1.0, 2.0, 0.0)), state="localized")
    transforms = nav2.listen(nav2.topics.tf)
    robot.stand_until(lambda: any(is_map_to_odom(one) for one in transforms))
    router.kill()
    back_s = time.monotonic() + 3.0
    robot.stand_until(lambda: time.monotonic() > back_s)
    start_router()
    before, back_s = len(system.lasers), time.monotonic()
    robot.stand_until(lambda: len(system.lasers) > before)
    assert time.monotonic() - back_s < stretched_s(1.5)  # it looks for the router once a second
    transform_s = [
        at_s
        for one, at_s in zip(transforms, nav2.received_at_s["/tf"], strict=False)
        if is_map_to_odom(one)
    ]
    for times_s in (transform_s, nav2.received_at_s[BOND.name]):
        gaps_s = [after - earlier for earlier, after in pairwise(times_s)]
        assert max(gaps_s) < stretched_s(1.0)
        assert times_s[-1] > back_s - stretched_s(1.0)

    late_graph = Graph(open_robot_session())
    wait_until(lambda: late_graph.endpoints() == ENDPOINTS)
    assert graph.gone_at_s == []  # nodes keep their direct links
    late = open_robot(name="late").listen(AMCL_POSE)
    wait_until(lambda: late)
    assert late[-1].pose.pose.position.y == 2.0


def is_map_to_odom(message: Any) -> bool:
    (link,) = message.transforms
    return (link.header.frame_id, link.child_frame_id) == ("map", "odom")


@pytest.mark.usefixtures("router")
def test_tokens_and_keys_have_the_domain_the_namespace_and_humbles_hash(
    open_robot_session: OpenSession, open_robot: OpenRobot, start_bridge: StartBridge
) -> None:
    settings = Ros2Settings(domain_id=7, namespace="/robot1", tf_topic="tf")
    graph = Graph(open_robot_session(), 7)
    robot = open_robot(settings, humble=True)
    robot.put_mounts()
    start_bridge(settings)
    wait_until(lambda: len(graph.of(namespace="%robot1")) == len(ENDPOINTS) + 1)
    seen = graph.endpoints(namespace="%robot1")
    absolute = ("/diagnostics", "/tf_static", "/parameter_events", "/rosout")
    expected = {
        one if one.split()[1] in absolute else one.replace(" /", " /robot1/", 1)
        for one in ENDPOINTS
    }
    assert seen == expected
    hashes = {parts[11] for parts in graph.of(namespace="%robot1") if parts[5] != "NN"}
    assert hashes == {HUMBLE_HASH}


@pytest.mark.usefixtures("router")
def test_a_second_node_of_the_name_is_refused(
    open_robot: OpenRobot, start_bridge: StartBridge
) -> None:
    open_robot(name="amcl").put_mounts()  # nav2's own
    bridge = start_bridge(expect="robot 'ROS domain 0' already has a node /amcl")
    assert bridge.wait() == 2


@pytest.mark.usefixtures("router")
def test_the_bridge_waits_for_a_node_to_detect_the_ros_release(
    open_robot_session: OpenSession, open_robot: OpenRobot, start_bridge: StartBridge
) -> None:
    bridge = start_bridge(expect="waiting for a node of ROS domain 0")
    assert not Graph(open_robot_session()).of()
    open_robot().put_mounts()
    bridge.wait_for("/amcl is running in ROS domain 0")
