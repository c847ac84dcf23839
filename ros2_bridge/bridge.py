"""Run one robot's bridge: two Zenoh sessions, the robot's and ours, and a loop between them."""

import logging
from contextlib import ExitStack

from process_runtime.settings import Settings
from process_runtime.stop import StopFlag
from ros2_bridge import topics
from ros2_bridge.bond import BondThread
from ros2_bridge.core_link import SUBSCRIBED, CoreLink
from ros2_bridge.loop import BridgeLoop, InboxEvent
from ros2_bridge.node import RosNode
from ros2_bridge.restart_file import restart_file
from ros2_bridge.robot_session import look_at_graph, node_name, open_robot_session
from ros2_bridge.ros_log import log_to_ros
from ros2_bridge.topics import Topics
from zenoh_link.inbox import Inbox
from zenoh_link.session import open_session

_log = logging.getLogger(__name__)

_KEPT_MESSAGES, _KEPT_TRANSFORMS = 64, 500


def serve_robot(settings: Settings, process: str, stop: StopFlag) -> None:
    """Run the node until `stop` is set; wait for the router and the robot if necessary.

    Args:
        settings: of all processes.
        process: name of this one.
        stop: ends the node.

    Raises:
        SettingsError: a name or an endpoint is invalid.
        AlreadyRunningError: the robot already has a node of that name.
        StoppedError: `stop` was set before a robot was found.
    """
    name, names = node_name(settings.ros2), Topics(settings.ros2)
    with ExitStack() as resources:
        humble = look_at_graph(settings, name, stop)
        robot = resources.enter_context(open_robot_session(settings, stop))
        core = resources.enter_context(
            open_session(settings.zenoh, settings.robot, stop, wait_s=None)
        )
        kept = dict.fromkeys((*SUBSCRIBED, *(topic.name for topic in names.read())), _KEPT_MESSAGES)
        inbox: Inbox[InboxEvent] = Inbox(kept | {names.tf.name: _KEPT_TRANSFORMS})
        node = RosNode(robot, name, humble=humble)
        publishers = {topic.name: node.publisher(topic) for topic in names.sent()}
        full_name = name.topic(name.name)
        resources.enter_context(log_to_ros(publishers[topics.ROSOUT.name], full_name))
        bond = BondThread(publishers[topics.BOND.name], settings.ros2.node_name)
        resources.enter_context(bond)
        file = resources.enter_context(restart_file(settings, full_name))
        link = CoreLink(core, process, inbox)
        loop = BridgeLoop(settings, inbox, link, publishers, bond, file)
        for service, ros_type in loop.services.types().items():
            node.serve(service, ros_type, inbox)
        for topic in names.read():
            node.subscribe(topic, inbox, own=topic != names.tf)
        _log.info("%s is running in ROS domain %d", full_name, name.domain_id)
        loop.run(stop)
