"""ROS messages without ROS: the library `rosbags` creates, encodes and decodes them."""

from functools import cache
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from clustermcl.recordings.rigid import Rigid
from clustermcl.ros2 import message_types
from clustermcl.ros2.messages_out import transform

_NOTHING = "uint8 structure_needs_at_least_one_member\n"
_HYPOTHESIS = "vision_msgs/msg/ObjectHypothesis"
_MESSAGES = {
    "nav2_msgs/msg/Particle": "geometry_msgs/Pose pose\nfloat64 weight\n",
    message_types.PARTICLE_CLOUD: "std_msgs/Header header\nnav2_msgs/Particle[] particles\n",
    _HYPOTHESIS: "string class_id\nfloat64 score\n",
    f"{_HYPOTHESIS}WithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    message_types.DETECTION: (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id\n"
    ),
    "apriltag_msgs/msg/AprilTagDetection": "string family\nint32 id\n",
    message_types.APRIL_TAGS: (
        "std_msgs/Header header\napriltag_msgs/AprilTagDetection[] detections\n"
    ),
    "std_srvs/msg/Empty_Response": _NOTHING,
    "std_srvs/msg/Trigger_Response": "bool success\nstring message\n",
    "nav2_msgs/msg/SetInitialPose_Request": "geometry_msgs/PoseWithCovarianceStamped pose\n",
    "nav2_msgs/msg/SetInitialPose_Response": _NOTHING,
}
_MOST_BYTES = 4096
"""More than any message of zeros has."""


@cache
def typestore() -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in _MESSAGES.items():
        store.register(get_types_from_msg(text, name))
    return store


def create(ros_type: str, fields: dict[str, Any]) -> Any:
    ros_type = ros_type.replace("/srv/", "/msg/")  # the library has no services
    return typestore().types[ros_type](**_defaults(ros_type) | fields)


def new(ros_type: str, **fields: Any) -> Any:
    return create(ros_type, fields)


def decode(data: bytes, ros_type: str) -> Any:
    return typestore().deserialize_cdr(data, ros_type)


def link(parent: str, child: str, at: Rigid) -> Any:
    """A `TFMessage` of one link, at time 0."""
    one = transform((at.x, at.y, 0.0), 0, parent, child)
    one.transforms[0].transform.translation.z = at.z
    turn = new("geometry_msgs/msg/Quaternion", x=at.qx, y=at.qy, z=at.qz, w=at.qw)
    one.transforms[0].transform.rotation = turn
    return one


@cache
def _defaults(ros_type: str) -> dict[str, Any]:
    """The fields of a message of zero bytes in ROS 1's encoding; in CDR no text is empty."""
    kind, store = typestore().get_msgdef(ros_type), typestore()
    message, _ = kind.deserialize_ros1(memoryview(bytes(_MOST_BYTES)), 0, kind.cls, store)
    return vars(message)


message_types.use(create)
