"""The node's topics: those of AMCL and more, with names, types and QoS."""

from dataclasses import dataclass

from clustermcl.protocol.errors import SettingsError
from clustermcl.ros2 import message_types as types
from clustermcl.runtime.settings import Ros2Settings


@dataclass(frozen=True)
class Qos:
    """Quality of service of a topic.

    Messages of a `best_effort` topic may be lost. Late subscribers of a `latched` one get the last
    `depth` messages (`transient local`).
    """

    depth: int = 10
    best_effort: bool = False
    latched: bool = False


@dataclass(frozen=True)
class Topic:
    """A topic by ROS's rules: ``/absolute``, ``relative`` or ``~/private``."""

    name: str
    ros_type: str
    qos: Qos


_LAST = Qos(depth=1, latched=True)

AMCL_POSE = Topic("amcl_pose", types.POSE_STAMPED, _LAST)
PARTICLE_CLOUD = Topic("particle_cloud", types.PARTICLE_CLOUD, Qos(depth=5, best_effort=True))
DIAGNOSTICS = Topic("/diagnostics", types.DIAGNOSTIC_ARRAY, Qos())
HYPOTHESES = Topic("~/hypotheses", types.MARKER_ARRAY, _LAST)
HYPOTHESIS_DETECTION = Topic("~/hypotheses/detection", types.DETECTION, _LAST)
ADVICE = Topic("~/advice", types.PATH, _LAST)
CHANGES = Topic("~/changes", types.OCCUPANCY_GRID, _LAST)
FLOOR = Topic("~/floor", types.STRING, _LAST)
STATE = Topic("~/state", types.STRING, _LAST)
PROBABILITY = Topic("~/probability", types.FLOAT64, _LAST)
BOND = Topic("bond", types.BOND_STATUS, Qos(depth=5))

TF = Topic("/tf", types.TF_MESSAGE, Qos(depth=100))
TF_STATIC = Topic("/tf_static", types.TF_MESSAGE, Qos(depth=100, latched=True))
INITIAL_POSE = Topic("initialpose", types.POSE_STAMPED, Qos())

SENT = (
    *(AMCL_POSE, PARTICLE_CLOUD, TF, DIAGNOSTICS, BOND),
    *(HYPOTHESES, HYPOTHESIS_DETECTION, ADVICE, CHANGES, STATE, FLOOR, PROBABILITY),
)


def _topics(names: str, ros_type: str, qos: Qos) -> tuple[Topic, ...]:
    """Return the topics of a setting, which separates names by commas."""
    distinct = dict.fromkeys(filter(None, map(str.strip, names.split(","))))
    return tuple(Topic(name, ros_type, qos) for name in distinct)


class Topics:
    """Those whose names are settings, and all that are read."""

    def __init__(self, settings: Ros2Settings) -> None:
        sensor_data = Qos(depth=5, best_effort=True)
        self.map = Topic(settings.map_topic, types.OCCUPANCY_GRID, _LAST)
        self.scans = _topics(settings.scan_topic, types.LASER_SCAN, sensor_data)
        if not self.scans:
            raise SettingsError(f"scan_topic = {settings.scan_topic!r}: name a topic of scans")
        self.observed = (
            *_topics(settings.pose_topics, types.POSE_STAMPED, Qos()),
            *_topics(settings.tag_topics, types.APRIL_TAGS, sensor_data),
        )

    def read(self) -> tuple[Topic, ...]:
        return (*self.scans, TF, TF_STATIC, self.map, INITIAL_POSE, *self.observed)
