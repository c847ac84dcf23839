"""Settings of the node in the place of AMCL on a ROS 2 robot."""

from typing import Literal, TypeAlias

import msgspec

from clustermcl.filter.settings import NotNegative, Positive

Publish: TypeAlias = Literal["held", "best", "localized"]
"""Which of several places is published as the pose; see `clustermcl.ros2.pose_choice`."""


class Ros2Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The node in the place of AMCL; its parameters have nav2's names too."""

    autostart: bool = False
    """Become active without nav2's lifecycle manager."""
    scan_topic: str = "scan"
    """Laser scans; several topics are separated by commas."""
    pose_topics: str = ""
    """Poses in the map by other sensors, separated by commas; empty: none."""
    gnss_topics: str = ""
    """Satellite fixes, separated by commas; they need a datum."""
    datum: str = ""
    """Latitude and longitude of the map's origin, and direction of its x axis, counter-clockwise
    from east, separated by commas [deg]."""
    tag_topics: str = ""
    """Detected AprilTags, whose poses are in tf, separated by commas."""
    detection_topics: str = ""
    """Detected landmarks in three dimensions, separated by commas."""
    sight_sigma_per_m: Positive = 0.05
    """Standard deviation of a detection without covariance, for each metre to it."""
    map_topic: str = "map"
    """The map, latched."""
    global_frame: str = "map"
    """Tf's frame of the map."""
    odom_frame: str = "odom"
    """Tf's frame of odometry."""
    base_frame: str = "base_footprint"
    """Tf's frame of the robot."""
    transform_tolerance_s: NotNegative = 1.0
    """Map to odom is stamped this much after its scan; scans wait this long for tf [s]."""
    tf_broadcast: bool = True
    """Send map to odom; else another node does."""
    publish: Publish = "held"
    """Pose while several places are possible: held (the last localized place, until another is
    localized or it ends), best (most probable, may jump), localized (no pose)."""
    laser_min_range_m: float = -1.0
    """Nearer beams count as no return; negative: the scan's range_min [m]."""
    laser_max_range_m: float = -1.0
    """Farther beams count as no return; 0 or negative: the scan's range_max [m]."""
    first_map_only: bool = False
    """Ignore all maps after the first."""
    set_initial_pose: bool = False
    """Start at the initial pose below at each activation."""
    initial_x_m: float = 0.0
    """Initial pose in the map [m]."""
    initial_y_m: float = 0.0
    """Initial pose in the map [m]."""
    initial_heading_rad: float = 0.0
    """Initial pose in the map [rad]."""
    initial_floor: str = ""
    """Floor of a building for the initial pose, and for poses given before a floor is known."""
    load_floor_maps: bool = False
    """Have nav2's map_server/load_map load the map of each floor on which the robot is sure; map to
    odom waits for the answer. The building is that of bridge.map."""
    always_reset_initial_pose: bool = False
    """Search the whole map after each reset instead of continuing."""

    def __post_init__(self) -> None:
        # ROS 1 put a slash before frame names; tf2 has none.
        for frame in ("global_frame", "odom_frame", "base_frame"):
            msgspec.structs.force_setattr(self, frame, getattr(self, frame).removeprefix("/"))
