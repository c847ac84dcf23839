"""Settings of the process that stands in for AMCL on a ROS 2 robot."""

from typing import Annotated, Literal, TypeAlias

import msgspec

from particle_filter.settings import described

Publish: TypeAlias = Literal["held", "best", "localized"]
"""Which place is told as the pose while there are several: see `ros2_bridge.pose_choice`."""
TypeHashes: TypeAlias = Literal["auto", "rihs01", "humble"]


class Ros2Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """AMCL's place on a robot whose ROS 2 speaks rmw_zenoh."""

    enabled: Annotated[bool, described("`clustermcl up` also starts the bridge to ROS 2")] = False
    router: Annotated[
        str, described("endpoint of the robot's rmw_zenohd; empty: the same as zenoh.router")
    ] = ""
    domain_id: Annotated[int, described("ROS_DOMAIN_ID of the robot", ge=0, le=232)] = 0
    namespace: Annotated[str, described("of the node, such as /robot1; empty: the root")] = ""
    node_name: Annotated[str, described("of the node; nav2 looks for amcl")] = "amcl"
    type_hashes: Annotated[
        TypeHashes,
        described("how the robot's release names types; auto: as its nodes do, once they are seen"),
    ] = "auto"
    autostart: Annotated[
        bool, described("become active without nav2's lifecycle manager asking for it")
    ] = False
    use_sim_time: Annotated[bool, described("stamps of our own come from /clock")] = False
    scan_topic: Annotated[
        str, described("laser scans; several topics with commas between; lasers by their frames")
    ] = "scan"
    pointcloud_topic: Annotated[
        str, described("point clouds of which a slice is one more laser; empty: none")
    ] = ""
    min_height_m: Annotated[
        float, described("the slice begins so high above the base frame", "m")
    ] = 0.1
    max_height_m: Annotated[float, described("and ends so high", "m")] = 1.0
    map_topic: Annotated[str, described("the map, latched")] = "map"
    tf_topic: Annotated[
        str, described("transforms; nav2's launch files remap /tf to tf in the namespace")
    ] = "/tf"
    tf_static_topic: Annotated[str, described("transforms that stay")] = "/tf_static"
    global_frame: Annotated[str, described("tf's frame of the map")] = "map"
    odom_frame: Annotated[str, described("tf's frame of odometry")] = "odom"
    base_frame: Annotated[str, described("tf's frame of the robot")] = "base_footprint"
    transform_tolerance_s: Annotated[
        float,
        described(
            "map to odom holds so much longer than its scan; scans wait so long for tf", "s", ge=0
        ),
    ] = 1.0
    tf_broadcast: Annotated[bool, described("send map to odom; else another node does")] = True
    publish: Annotated[
        Publish,
        described(
            "which place is the pose while several are possible: held (the one last localized, "
            "until another is, or it ends), best (jumps), localized (none then)"
        ),
    ] = "held"
    laser_min_range_m: Annotated[
        float, described("nearer beams are no return; negative: as the scan says", "m")
    ] = -1.0
    laser_max_range_m: Annotated[
        float, described("farther beams are no return; 0 or negative: as the scan says", "m")
    ] = -1.0
    first_map_only: Annotated[bool, described("keep the first map, whatever comes later")] = False
    set_initial_pose: Annotated[
        bool, described("begin at the initial pose below, each time it becomes active")
    ] = False
    initial_x_m: Annotated[float, described("initial pose in the map", "m")] = 0.0
    initial_y_m: Annotated[float, described("initial pose in the map", "m")] = 0.0
    initial_heading_rad: Annotated[float, described("initial pose in the map", "rad")] = 0.0
    always_reset_initial_pose: Annotated[
        bool, described("search everywhere after each reset, instead of going on")
    ] = False

    def __post_init__(self) -> None:
        """ROS 1 put a slash in front of frames; tf2 has none."""
        for frame in ("global_frame", "odom_frame", "base_frame"):
            msgspec.structs.force_setattr(self, frame, getattr(self, frame).removeprefix("/"))
