"""The types of ROS's messages and services, and their creation by a library that is given."""

from collections.abc import Callable
from typing import Any, TypeAlias

LASER_SCAN = "sensor_msgs/msg/LaserScan"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
POSE_STAMPED = "geometry_msgs/msg/PoseWithCovarianceStamped"
PATH = "nav_msgs/msg/Path"
PARTICLE_CLOUD = "nav2_msgs/msg/ParticleCloud"
MARKER_ARRAY = "visualization_msgs/msg/MarkerArray"
APRIL_TAGS = "apriltag_msgs/msg/AprilTagDetectionArray"
DETECTION = "vision_msgs/msg/Detection3D"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
STRING = "std_msgs/msg/String"
FLOAT64 = "std_msgs/msg/Float64"
BOND_STATUS = "bond/msg/Status"

EMPTY = "std_srvs/srv/Empty"
TRIGGER = "std_srvs/srv/Trigger"
SET_INITIAL_POSE = "nav2_msgs/srv/SetInitialPose"

Create: TypeAlias = Callable[[str, dict[str, Any]], Any]
"""Creates a message of a type with these fields; the others are zero, empty or false."""


class _Library:
    create: Create


def use(create: Create) -> None:
    """Create all messages of this process with this function."""
    _Library.create = staticmethod(create)


def new(ros_type: str, **fields: Any) -> Any:
    """Create a message, or a half of a service such as `std_srvs/srv/Empty_Response`."""
    return _Library.create(ros_type, fields)
