"""All settings of the system, one structure per section, with defaults, units and meanings."""

from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import Meta

from clustermcl.filter.settings import (
    FilterSettings,
    NotNegative,
    NotNegativeInt,
    Positive,
    PositiveInt,
)
from clustermcl.protocol.keys import LONGEST_NAME, NAME_PATTERN

ROBOT_VARIABLE, ROUTER_VARIABLE = "CLUSTERMCL_ROBOT", "CLUSTERMCL_ROUTER"
"""Environment variables for `robot.name` and `zenoh.router` of commands and `Client`."""


class RobotSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the robot that the processes serve."""

    name: Annotated[str, Meta(pattern=NAME_PATTERN, max_length=LONGEST_NAME)] = "robot"
    """Robot's name; separates the keys of several robots on one router."""
    radius_m: Annotated[float, Meta(ge=0, le=10)] = 0.0
    """Radius of the footprint, for the page and for advice; 0: none, and 0.3 m for advice [m]."""


SOCKET_PATH_MAX_BYTES = 107
"""Longest path of a Unix socket on Linux."""


class ZenohSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the connections: every process is a client of one router."""

    router: str = "tcp/127.0.0.1:7447"
    """Endpoint of the router: where it listens and where clients connect."""
    start_router: bool = True
    """`clustermcl up` starts that router; false: one is running."""
    connect_timeout_s: Positive = 2.0
    """Time-out of a command for connecting to the router [s]."""
    query_timeout_s: Positive = 1.0
    """Time-out of a query [s]."""
    tls_ca_certificate: str = ""
    """For tls/: file of the authority that signed the certificates."""
    tls_certificate: str = ""
    """For tls/: file of this process's own certificate."""
    tls_private_key: str = ""
    """For tls/: file of the key of that certificate."""


class BridgeSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Map, source of readings, and when a scan becomes a step."""

    map: str = ""
    """Map file: map_server YAML, may be .gz or .xz; zenoh: the map that the robot publishes."""
    landmarks: str = ""
    """Landmarks file of a map that the robot publishes; that of a map file is in its folder."""
    source: str = "zenoh"
    """A recording's path, sim:WORLD, sim:MAP.yaml, or zenoh (readings of a robot)."""
    rate: NotNegative = 1.0
    """Speed of a recording: 1 real time, 2 twice as fast, 0 lockstep with the workers."""
    gate_distance_m: NotNegative = 0.2
    """A scan becomes a step after driving this distance [m]."""
    gate_turn_rad: NotNegative = 0.2
    """Or after turning by this angle [rad]."""
    min_range_m: NotNegative = 0.0
    """Shorter ranges count as no return, of all sources [m]."""
    laser_x_m: float = 0.0
    """Laser ahead of the robot's centre, if the source has no mount [m]."""
    laser_y_m: float = 0.0
    """Laser left of the robot's centre, if the source has no mount [m]."""
    laser_heading_rad: float = 0.0
    """Laser's heading, if the source has no mount [rad]."""
    scan_topic: str = ""
    """Laser's topic in a ROS bag; empty: the only one."""
    odom_topic: str = ""
    """Odometry's topic in a ROS bag; empty: tf, if the bag has it."""
    odom_frame: str = ""
    """Frame of odometry in a ROS bag's tf; empty: odom."""
    base_frame: str = ""
    """Frame of the robot in a ROS bag's tf; empty: the child of odometry's."""


class CoordinatorSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Deadlines, fail-over and stored state of the coordinator."""

    step_deadline_s: Positive = 0.5
    """Longest time from a scan to applying its step [s]."""
    lockstep_deadline_s: Positive = 20.0
    """The same in lockstep with the workers [s]."""
    search_deadline_s: NotNegative = 0.0
    """Time after its scan that a step with reports from all clusters waits for a search; a later
    result counts with the next step [s]."""
    stale_after_s: Positive = 1.0
    """A pose whose newest data is older is stale [s]."""
    dead_reckoning_after_gates: Annotated[float, Meta(gt=1)] = 5.0
    """Freshness is dead_reckoning after driving this many gates without a weighed scan [gates]."""
    snapshot_every_steps: PositiveInt = 10
    """Interval of a worker's state snapshots [steps]."""
    standby: bool = False
    """Wait while the robot has a coordinator, and take over when it fails."""
    take_over_after_s: Positive = 2.0
    """Time without a sign of life after which a coordinator is dead [s]."""
    state_folder: str = ""
    """Folder for the state, with which a restarted coordinator continues; empty: the user's state
    folder; off: none."""
    last_pose_probability: Annotated[float, Meta(ge=0, le=0.5)] = 0.1
    """Probability of the last place after the first search; 0: none."""
    keep_pose_on_new_map: bool = False
    """A new map shows the same place: start in it from the poses in the old one; false: search the
    whole new map."""


class WorkerSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Worker processes of this machine."""

    count: NotNegativeInt = 0
    """Worker processes; 0: as many as have work, from 2 to one for each core."""
    cache_folder: str = ""
    """Folder for likelihood fields; empty: the user's cache folder."""


class LogSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The log on standard error."""

    level: Literal["debug", "info", "warning", "error"] = "info"
    """Least severe message shown."""


class RecorderSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The flight recorder of the coordinator, for `clustermcl replay`."""

    folder: str = ""
    """Folder for the coordinator's input, one subfolder per robot; empty: none, but with
    `clustermcl up` the user's state folder; off: none."""
    max_mb: Annotated[float, Meta(ge=1)] = 50.0
    """Size of a robot's recording; the oldest files are deleted [MB]."""


class MetricsSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Prometheus metrics, served by the coordinator."""

    port: Annotated[int, Meta(ge=0, le=65535)] = 0
    """Port of /metrics; 0: not served."""
    host: str = "127.0.0.1"
    """Address of this machine to listen on."""


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
    tag_topics: str = ""
    """Detected AprilTags, whose poses are in tf, separated by commas."""
    sight_sigma_per_m: Positive = 0.05
    """Standard deviation of a tag's position, for each metre to it."""
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


class Settings(FilterSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The whole settings file: sections in TOML, `--set section.key=value` on a command line."""

    robot: RobotSettings = RobotSettings()
    zenoh: ZenohSettings = ZenohSettings()
    bridge: BridgeSettings = BridgeSettings()
    coordinator: CoordinatorSettings = CoordinatorSettings()
    worker: WorkerSettings = WorkerSettings()
    log: LogSettings = LogSettings()
    metrics: MetricsSettings = MetricsSettings()
    recorder: RecorderSettings = RecorderSettings()
    ros2: Ros2Settings = Ros2Settings()
