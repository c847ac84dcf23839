"""Settings of the process that stands in for AMCL on a ROS 2 robot."""

from typing import Annotated, Literal, TypeAlias

import msgspec

from particle_filter.settings import described

Publish: TypeAlias = Literal["held", "best", "localized"]
"""Which place is published as the pose while there are several; see `ros2_bridge.pose_choice`."""
TypeHashes: TypeAlias = Literal["auto", "rihs01", "humble"]


class Ros2Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Replacement of AMCL on a robot whose ROS 2 uses rmw_zenoh."""

    enabled: Annotated[bool, described("`clustermcl up` also starts the bridge to ROS 2")] = False
    router: Annotated[
        str, described("endpoint of the robot's rmw_zenohd; empty: the same as zenoh.router")
    ] = ""
    domain_id: Annotated[int, described("ROS_DOMAIN_ID of the robot", ge=0, le=232)] = 0
    namespace: Annotated[
        str, described("namespace of the node, such as /robot1; empty: the root")
    ] = ""
    node_name: Annotated[str, described("name of the node; nav2 expects amcl")] = "amcl"
    type_hashes: Annotated[
        TypeHashes,
        described("type hashes of the robot's ROS release; auto: those of the nodes found"),
    ] = "auto"
    autostart: Annotated[bool, described("become active without nav2's lifecycle manager")] = False
    use_sim_time: Annotated[bool, described("take the time from /clock")] = False
    scan_topic: Annotated[str, described("laser scans; several topics are separated by commas")] = (
        "scan"
    )
    pointcloud_topic: Annotated[
        str, described("point clouds; a slice of them is one more laser; empty: none")
    ] = ""
    min_height_m: Annotated[
        float, described("lower edge of that slice above the base frame", "m")
    ] = 0.1
    max_height_m: Annotated[float, described("upper edge of that slice", "m")] = 1.0
    pose_topics: Annotated[
        str, described("poses in the map by other sensors, separated by commas; empty: none")
    ] = ""
    gnss_topics: Annotated[
        str, described("satellite fixes, separated by commas; they need a datum")
    ] = ""
    datum: Annotated[
        str,
        described(
            "latitude and longitude of the map's origin, and direction of its x axis, counter-"
            "clockwise from east, separated by commas",
            "deg",
        ),
    ] = ""
    tag_topics: Annotated[
        str, described("detected AprilTags, whose poses are in tf, separated by commas")
    ] = ""
    detection_topics: Annotated[
        str, described("detected landmarks in three dimensions, separated by commas")
    ] = ""
    sight_sigma_per_m: Annotated[
        float,
        described(
            "standard deviation of a detection without covariance, for each metre to it", gt=0
        ),
    ] = 0.05
    map_topic: Annotated[str, described("the map, latched")] = "map"
    tf_topic: Annotated[
        str, described("transforms; nav2's launch files remap /tf to tf in the namespace")
    ] = "/tf"
    tf_static_topic: Annotated[str, described("static transforms")] = "/tf_static"
    global_frame: Annotated[str, described("tf's frame of the map")] = "map"
    odom_frame: Annotated[str, described("tf's frame of odometry")] = "odom"
    base_frame: Annotated[str, described("tf's frame of the robot")] = "base_footprint"
    transform_tolerance_s: Annotated[
        float,
        described(
            "map to odom is stamped this much after its scan; scans wait this long for tf",
            "s",
            ge=0,
        ),
    ] = 1.0
    tf_broadcast: Annotated[bool, described("send map to odom; else another node does")] = True
    publish: Annotated[
        Publish,
        described(
            "pose while several places are possible: held (the last localized place, until another "
            "is localized or it ends), best (most probable, may jump), localized (no pose)"
        ),
    ] = "held"
    laser_min_range_m: Annotated[
        float, described("nearer beams count as no return; negative: the scan's range_min", "m")
    ] = -1.0
    laser_max_range_m: Annotated[
        float,
        described("farther beams count as no return; 0 or negative: the scan's range_max", "m"),
    ] = -1.0
    first_map_only: Annotated[bool, described("ignore all maps after the first")] = False
    set_initial_pose: Annotated[
        bool, described("start at the initial pose below at each activation")
    ] = False
    initial_x_m: Annotated[float, described("initial pose in the map", "m")] = 0.0
    initial_y_m: Annotated[float, described("initial pose in the map", "m")] = 0.0
    initial_heading_rad: Annotated[float, described("initial pose in the map", "rad")] = 0.0
    always_reset_initial_pose: Annotated[
        bool, described("search the whole map after each reset instead of continuing")
    ] = False

    def __post_init__(self) -> None:
        # ROS 1 put a slash before frame names; tf2 has none.
        for frame in ("global_frame", "odom_frame", "base_frame"):
            msgspec.structs.force_setattr(self, frame, getattr(self, frame).removeprefix("/"))
