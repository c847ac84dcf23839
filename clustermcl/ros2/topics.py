"""The node's topics: those of AMCL and more, with names, types and QoS."""

from dataclasses import dataclass

from clustermcl.ros2 import message_types as types
from clustermcl.ros2.wire import Qos
from clustermcl.runtime.ros2_settings import Ros2Settings


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
TRANSITION_EVENT = Topic("~/transition_event", types.TRANSITION_EVENT, Qos())
PARAMETER_EVENTS = Topic("/parameter_events", types.PARAMETER_EVENT, Qos(depth=1000))
ROSOUT = Topic("/rosout", types.LOG, Qos(depth=1000, latched=True))
BOND = Topic("bond", types.BOND_STATUS, Qos(depth=5))

INITIAL_POSE = Topic("initialpose", types.POSE_STAMPED, Qos())
CLOCK = Topic("/clock", types.CLOCK, Qos(depth=1, best_effort=True))


def _topics(names: str, ros_type: str, qos: Qos) -> tuple[Topic, ...]:
    """Return the topics of a setting, which separates names by commas."""
    distinct = dict.fromkeys(filter(None, map(str.strip, names.split(","))))
    return tuple(Topic(name, ros_type, qos) for name in distinct)


class Topics:
    """The topics whose names are settings."""

    def __init__(self, settings: Ros2Settings) -> None:
        sensor_data = Qos(depth=5, best_effort=True)
        self.tf = Topic(settings.tf_topic, types.TF_MESSAGE, Qos(depth=100))
        tf_qos = Qos(depth=100, latched=True)
        self.tf_static = Topic(settings.tf_static_topic, types.TF_MESSAGE, tf_qos)
        self.map = Topic(settings.map_topic, types.OCCUPANCY_GRID, _LAST)
        self.scans = _topics(settings.scan_topic, types.LASER_SCAN, sensor_data)
        self.observed = (
            *_topics(settings.pose_topics, types.POSE_STAMPED, Qos()),
            *_topics(settings.gnss_topics, types.NAV_SAT_FIX, sensor_data),
            *_topics(settings.tag_topics, types.APRIL_TAGS, sensor_data),
            *_topics(settings.detection_topics, types.DETECTIONS, sensor_data),
        )
        self._clock = (CLOCK,) if settings.use_sim_time else ()

    def read(self) -> tuple[Topic, ...]:
        transforms = (self.tf, self.tf_static)
        return (*self.scans, *transforms, self.map, INITIAL_POSE, *self.observed, *self._clock)

    def sent(self) -> tuple[Topic, ...]:
        return (
            *(AMCL_POSE, PARTICLE_CLOUD, self.tf, DIAGNOSTICS, TRANSITION_EVENT, BOND),
            *(PARAMETER_EVENTS, ROSOUT),
            *(HYPOTHESES, HYPOTHESIS_DETECTION, ADVICE, CHANGES, STATE, FLOOR, PROBABILITY),
        )
