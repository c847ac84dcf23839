"""Encode and decode ROS messages, and hash their types, without ROS.

The library `rosbags` defines most types and encodes them (CDR); missing types are defined here.
Messages are objects of its classes, with ROS's field names.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.ros2.wire import HUMBLE_HASH

LASER_SCAN = "sensor_msgs/msg/LaserScan"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
POSE_STAMPED = "geometry_msgs/msg/PoseWithCovarianceStamped"
PATH = "nav_msgs/msg/Path"
CLOCK = "rosgraph_msgs/msg/Clock"
PARTICLE_CLOUD = "nav2_msgs/msg/ParticleCloud"
MARKER_ARRAY = "visualization_msgs/msg/MarkerArray"
NAV_SAT_FIX = "sensor_msgs/msg/NavSatFix"
APRIL_TAGS = "apriltag_msgs/msg/AprilTagDetectionArray"
DETECTION = "vision_msgs/msg/Detection3D"
DETECTIONS = "vision_msgs/msg/Detection3DArray"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
STRING = "std_msgs/msg/String"
FLOAT64 = "std_msgs/msg/Float64"
BOND_STATUS = "bond/msg/Status"
TRANSITION_EVENT = "lifecycle_msgs/msg/TransitionEvent"
PARAMETER_EVENT = "rcl_interfaces/msg/ParameterEvent"
LOG = "rcl_interfaces/msg/Log"

EMPTY = "std_srvs/srv/Empty"
TRIGGER = "std_srvs/srv/Trigger"
SET_INITIAL_POSE = "nav2_msgs/srv/SetInitialPose"
GET_STATE = "lifecycle_msgs/srv/GetState"
CHANGE_STATE = "lifecycle_msgs/srv/ChangeState"
GET_AVAILABLE_STATES = "lifecycle_msgs/srv/GetAvailableStates"
GET_AVAILABLE_TRANSITIONS = "lifecycle_msgs/srv/GetAvailableTransitions"
GET_PARAMETERS = "rcl_interfaces/srv/GetParameters"
SET_PARAMETERS = "rcl_interfaces/srv/SetParameters"
SET_PARAMETERS_ATOMICALLY = "rcl_interfaces/srv/SetParametersAtomically"
LIST_PARAMETERS = "rcl_interfaces/srv/ListParameters"
DESCRIBE_PARAMETERS = "rcl_interfaces/srv/DescribeParameters"
GET_PARAMETER_TYPES = "rcl_interfaces/srv/GetParameterTypes"

_NOTHING = "uint8 structure_needs_at_least_one_member\n"
_HYPOTHESIS = "vision_msgs/msg/ObjectHypothesis"

_MESSAGES = {
    "nav2_msgs/msg/Particle": "geometry_msgs/Pose pose\nfloat64 weight\n",
    PARTICLE_CLOUD: "std_msgs/Header header\nnav2_msgs/Particle[] particles\n",
    BOND_STATUS: (
        "std_msgs/Header header\nstring id\nstring instance_id\nbool active\n"
        "float32 heartbeat_timeout\nfloat32 heartbeat_period\n"
    ),
    _HYPOTHESIS: "string class_id\nfloat64 score\n",
    f"{_HYPOTHESIS}WithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    DETECTION: (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id\n"
    ),
    DETECTIONS: "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
    "apriltag_msgs/msg/Point": "float64 x\nfloat64 y\n",
    "apriltag_msgs/msg/AprilTagDetection": (
        "string family\nint32 id\nint32 hamming\nfloat32 goodness\nfloat32 decision_margin\n"
        "apriltag_msgs/Point centre\napriltag_msgs/Point[4] corners\nfloat64[9] homography\n"
    ),
    APRIL_TAGS: "std_msgs/Header header\napriltag_msgs/AprilTagDetection[] detections\n",
}
_SERVICES = {
    EMPTY: (_NOTHING, _NOTHING),
    TRIGGER: (_NOTHING, "bool success\nstring message\n"),
    SET_INITIAL_POSE: ("geometry_msgs/PoseWithCovarianceStamped pose\n", _NOTHING),
    GET_STATE: (_NOTHING, "lifecycle_msgs/State current_state\n"),
    CHANGE_STATE: ("lifecycle_msgs/Transition transition\n", "bool success\n"),
    GET_AVAILABLE_STATES: (_NOTHING, "lifecycle_msgs/State[] available_states\n"),
    GET_AVAILABLE_TRANSITIONS: (
        _NOTHING,
        "lifecycle_msgs/TransitionDescription[] available_transitions\n",
    ),
    GET_PARAMETERS: ("string[] names\n", "rcl_interfaces/ParameterValue[] values\n"),
    SET_PARAMETERS: (
        "rcl_interfaces/Parameter[] parameters\n",
        "rcl_interfaces/SetParametersResult[] results\n",
    ),
    SET_PARAMETERS_ATOMICALLY: (
        "rcl_interfaces/Parameter[] parameters\n",
        "rcl_interfaces/SetParametersResult result\n",
    ),
    LIST_PARAMETERS: (
        "string[] prefixes\nuint64 depth\n",
        "rcl_interfaces/ListParametersResult result\n",
    ),
    DESCRIBE_PARAMETERS: (
        "string[] names\n",
        "rcl_interfaces/ParameterDescriptor[] descriptors\n",
    ),
    GET_PARAMETER_TYPES: ("string[] names\n", "uint8[] types\n"),
}
"""Request and response of each service."""

_SERVICE_HASHES = {
    EMPTY: "5888399dedec5ccc85ea6451949fd2c9f97bfdf963f9a588821639fcd31b5d19",
    TRIGGER: "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
    SET_INITIAL_POSE: "1f818551d505d16d89c8bf9b07121a6408de4408b7889dfda9a0db326c296153",
    GET_STATE: "800a0a5aae599782b02932de0caf563f6dc4e7e94b794eadde075ba2cbef9795",
    CHANGE_STATE: "356fe34f0475a43acf54542013af4167b0e729f77ea22ffb045c6ad8e20668e5",
    GET_AVAILABLE_STATES: "00a07d79d2207d71e81a8cbc1880e5d924cc16d4688ea8e8e06e443dc8f8aa1d",
    GET_AVAILABLE_TRANSITIONS: "59b7ecefce0982a8a844b9f2c4f14764c1c4543cc55e72924e2aa4adad83e9bc",
    GET_PARAMETERS: "bf9803d5c74cf989a5de3e0c2e99444599a627c7ff75f97b8c05b01003675cbc",
    SET_PARAMETERS: "56eed9a67e169f9cb6c1f987bc88f868c14a8fc9f743a263bc734c154015d7e0",
    SET_PARAMETERS_ATOMICALLY: "0e192ef259c07fc3c07a13191d27002222e65e00ccec653ca05e856f79285fcd",
    LIST_PARAMETERS: "3e6062bfbb27bfb8730d4cef2558221f51a11646d78e7bb30a1e83afac3aad9d",
    DESCRIBE_PARAMETERS: "845b484d71eb0673dae682f2e3ba3c4851a65a3dcfb97bddd82c5b57e91e4cff",
    GET_PARAMETER_TYPES: "da199c878688b3e530bdfe3ca8f74cb9fa0c303101e980a9e8f260e25e1c80ca",
}
"""RIHS01 hashes of service types since ROS 2 Jazzy; `rosbags` cannot compute them."""

_HASH_FORM = "RIHS01_"
CDR_HEADER = b"\x00\x01\x00\x00"
"""Header of each message: plain CDR, little-endian."""
_LARGEST_BYTES = 4096
"""More than any message of zeros has."""


@cache
def typestore() -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in _MESSAGES.items():
        store.register(get_types_from_msg(text, name))
    for name, (request, response) in _SERVICES.items():
        store.register(get_types_from_msg(request, request_of(name)))
        store.register(get_types_from_msg(response, response_of(name)))
    return store


def type_hash(ros_type: str, *, humble: bool) -> str:
    """Return the hash of a message's or a service's type, as in keys; Humble has none."""
    if humble:
        return HUMBLE_HASH
    if ros_type in _SERVICE_HASHES:
        return _HASH_FORM + _SERVICE_HASHES[ros_type]
    return typestore().hash_rihs01(ros_type)


def request_of(service: str) -> str:
    return f"{_as_message(service)}_Request"


def response_of(service: str) -> str:
    return f"{_as_message(service)}_Response"


def _as_message(service: str) -> str:
    return service.replace("/srv/", "/msg/")  # the library has no services


def of_rosbags(ros_type: str, fields: dict[str, Any]) -> Any:
    """Messages share the objects of the other fields: do not change them afterwards."""
    return typestore().types[ros_type](**_defaults(ros_type) | fields)


class _Library:
    create: Callable[[str, dict[str, Any]], Any] = staticmethod(of_rosbags)


def use(create: Callable[[str, dict[str, Any]], Any]) -> None:
    """Create all messages of this process by this function of a type and its fields."""
    _Library.create = staticmethod(create)


def new(ros_type: str, **fields: Any) -> Any:
    """Create a message with these fields; the others are zero, empty or false, as in ROS.

    Raises:
        TypeError: the type has no such field.
    """
    return _Library.create(ros_type, fields)


def encode(message: Any, ros_type: str) -> bytes:
    return bytes(typestore().serialize_cdr(message, ros_type))


def decode(data: bytes, ros_type: str) -> Any:
    """Decode CDR bytes; arrays of numbers become numpy arrays.

    Raises:
        MalformedMessageError: the bytes are not a valid message of this type.
    """
    try:
        return typestore().deserialize_cdr(data, ros_type)
    except SerdeError as error:
        name = ros_type.rpartition("/")[2]
        raise MalformedMessageError(expected=name, problem=str(error), kind="not CDR") from None


@cache
def _defaults(ros_type: str) -> dict[str, Any]:
    """Return the fields of a message of zero bytes in ROS 1's encoding; in CDR no text is empty."""
    kind, store = typestore().get_msgdef(ros_type), typestore()
    message, _ = kind.deserialize_ros1(memoryview(bytes(_LARGEST_BYTES)), 0, kind.cls, store)
    return vars(message)
