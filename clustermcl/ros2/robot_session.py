"""The session to the robot's router, and the detection of the robot's ROS release."""

import logging
import re
from contextlib import AbstractContextManager

import msgspec
import zenoh

from clustermcl.link.session import MANY_LINKS, open_session, receiving_threads
from clustermcl.link.wire import alive
from clustermcl.protocol.errors import AlreadyRunningError, SettingsError
from clustermcl.ros2 import wire
from clustermcl.runtime.ros2_settings import Ros2Settings
from clustermcl.runtime.settings import Settings, ZenohSettings
from clustermcl.runtime.stop import StopFlag

OBSERVED = ("pose_topics", "gnss_topics", "tag_topics", "detection_topics")
"""Settings with the topics of other sensors."""
_ASK_S = 1.0
_LOOK_EVERY_S = 0.25
_GONE_WITHIN_S = 3.0
"""After a cable was cut, tokens of a dead process remain for a lease of 2 s."""
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_NAMES = re.compile(rf"{_NAME.pattern}(/{_NAME.pattern})*")
_TOPIC = re.compile(rf"(~/|/)?{_NAMES.pattern}")

_log = logging.getLogger(__name__)


def node_name(settings: Ros2Settings) -> wire.NodeName:
    """Return the name of the node; refuse settings with a name that is not valid in ROS."""
    namespace = settings.namespace.rstrip("/")
    if namespace and not namespace.startswith("/"):
        namespace = f"/{namespace}"
    named = {
        **{key: [getattr(settings, key)] for key in ("map_topic", "tf_topic", "tf_static_topic")},
        "scan_topic": settings.scan_topic.split(","),
        **{key: (getattr(settings, key) or "none").split(",") for key in OBSERVED},
    }
    wrong = [
        key for key, names in named.items() for name in names if not _TOPIC.fullmatch(name.strip())
    ]
    wrong += [] if _NAME.fullmatch(settings.node_name) else ["node_name"]
    wrong += [] if not namespace or _NAMES.fullmatch(namespace[1:]) else ["namespace"]
    for key in wrong:
        value = getattr(settings, key)
        raise SettingsError(f"ros2.{key} = {value!r}: ROS expects letters, digits, _ and slashes")
    return wire.NodeName(settings.domain_id, namespace, settings.node_name)


def look_at_graph(settings: Settings, name: wire.NodeName, stop: StopFlag) -> bool:
    """Refuse a second node; return whether the robot's release is ROS 2 Humble.

    A second node would publish map -> odom too. With the wrong form of keys, publishers appear in
    ROS's graph, but no message arrives. If the settings do not name the form, wait for a node.
    A client sees all tokens at once; a peer sees them once it is linked to every other peer.
    """
    robot, hashes = _robot_settings(settings), settings.ros2.type_hashes
    full_name, domain = name.topic(name.name), f"ROS domain {name.domain_id}"
    left, logged = round(_GONE_WITHIN_S / _LOOK_EVERY_S), False
    # The first session sets the number of threads for all; a peer has a link to every node.
    with receiving_threads(MANY_LINKS), open_session(robot, None, stop, wait_s=None) as session:
        while True:
            tokens = alive(session, f"{wire.GRAPH}/{name.domain_id}/**", _ASK_S)
            found = list(filter(None, map(wire.hash_in_token, tokens)))
            if full_name in map(wire.node_in_token, tokens):
                if not left:
                    raise AlreadyRunningError(
                        what=f"a node {full_name}",
                        robot=domain,
                        endpoint=robot.router,
                        advice="stop it (nav2's own amcl?), or choose another ros2.node_name",
                    )
                left -= 1
            elif hashes != "auto":
                return hashes == "humble"
            elif found:
                return found[0] == wire.HUMBLE_HASH
            elif not logged:
                logged = True
                _log.info("waiting for a node of %s, to detect its ROS release", domain)
            stop.wait(_LOOK_EVERY_S)
            stop.check()


def open_robot_session(settings: Settings, stop: StopFlag) -> AbstractContextManager[zenoh.Session]:
    """Open the session to the robot's router, without a namespace.

    On the router's machine it is a peer, like ROS nodes, whose direct links survive the router.
    On another machine it is a client: nodes are reachable only through the router, and direct links
    would bypass the access control of a router with TLS.
    """
    robot = _robot_settings(settings)
    return open_session(robot, None, stop, wait_s=None, peer=is_of_this_machine(robot.router))


def _robot_settings(settings: Settings) -> ZenohSettings:
    router = settings.ros2.router or settings.zenoh.router
    return msgspec.structs.replace(settings.zenoh, router=router)


def is_of_this_machine(router: str) -> bool:
    """Return whether an endpoint is a Unix socket, or plain TCP on the loopback interface."""
    return router.startswith(("unixsock-stream/", "tcp/localhost:", "tcp/127.", "tcp/[::1]:"))
