"""All settings of the system, one structure per section, with defaults, units and meanings."""

from typing import Annotated, Literal

import msgspec

from particle_filter.settings import FilterSettings, described
from process_runtime.ros2_settings import Ros2Settings
from protocol.names import LONGEST_NAME, NAME_PATTERN

ROBOT_VARIABLE, ROUTER_VARIABLE = "CLUSTERMCL_ROBOT", "CLUSTERMCL_ROUTER"
"""Environment variables for `robot.name` and `zenoh.router` of commands and `Client`."""


class RobotSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the robot that the processes serve."""

    name: Annotated[
        str,
        described(
            "robot's name; separates the keys of several robots on one router",
            pattern=NAME_PATTERN,
            max_length=LONGEST_NAME,
        ),
    ] = "robot"
    radius_m: Annotated[
        float, described("radius of the footprint that the page draws; 0: none", "m", ge=0, le=10)
    ] = 0.0


class ZenohSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the connections: every process is a client of one router."""

    router: Annotated[
        str, described("endpoint of the router: where it listens and where clients connect")
    ] = "tcp/127.0.0.1:7447"
    start_router: Annotated[
        bool,
        described("`clustermcl up` starts that router; false: one is running, such as rmw_zenohd"),
    ] = True
    connect_timeout_s: Annotated[
        float, described("time-out of a command for connecting to the router", "s", gt=0)
    ] = 2.0
    query_timeout_s: Annotated[float, described("time-out of a query", "s", gt=0)] = 1.0
    tls_ca_certificate: Annotated[
        str, described("for tls/: file of the authority that signed the certificates")
    ] = ""
    tls_certificate: Annotated[
        str, described("for tls/: file of this process's own certificate")
    ] = ""
    tls_private_key: Annotated[str, described("for tls/: file of the key of that certificate")] = ""


class BridgeSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Map, source of readings, and when a scan becomes a step."""

    map: Annotated[
        str,
        described(
            "map file: map_server YAML or wean.dat, may be .gz or .xz; zenoh, or empty with "
            "ros2.enabled: the map that the robot publishes"
        ),
    ] = ""
    source: Annotated[
        str,
        described("a recording's path, sim:WORLD, sim:MAP.yaml, or zenoh (readings of a robot)"),
    ] = "zenoh"
    rate: Annotated[
        float,
        described(
            "speed of a recording: 1 real time, 2 twice as fast, 0 lockstep with the workers", ge=0
        ),
    ] = 1.0
    gate_distance_m: Annotated[
        float, described("a scan becomes a step after driving this distance", "m", ge=0)
    ] = 0.2
    gate_turn_rad: Annotated[float, described("or after turning by this angle", "rad", ge=0)] = 0.2
    laser_x_m: Annotated[
        float, described("laser ahead of the robot's centre, if the source has no mount", "m")
    ] = 0.0
    laser_y_m: Annotated[
        float, described("laser left of the robot's centre, if the source has no mount", "m")
    ] = 0.0
    laser_heading_rad: Annotated[
        float, described("laser's heading, if the source has no mount", "rad")
    ] = 0.0
    scan_topic: Annotated[str, described("laser's topic in a ROS bag; empty: the only one")] = ""
    odom_topic: Annotated[
        str, described("odometry's topic in a ROS bag; empty: tf, if the bag has it")
    ] = ""
    odom_frame: Annotated[str, described("tf frame of odometry in a ROS bag; empty: odom")] = ""
    base_frame: Annotated[
        str, described("tf frame of the robot in a ROS bag; empty: the child of odometry's")
    ] = ""


class CoordinatorSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Deadlines, fail-over and stored state of the coordinator."""

    step_deadline_s: Annotated[
        float, described("longest time from a scan to applying its step", "s", gt=0)
    ] = 0.5
    lockstep_deadline_s: Annotated[
        float, described("the same in lockstep with the workers", "s", gt=0)
    ] = 20.0
    search_deadline_s: Annotated[
        float,
        described(
            "time after its scan that a step with reports from all clusters waits for a search; "
            "a later result counts with the next step",
            "s",
            ge=0,
        ),
    ] = 0.0
    stale_after_s: Annotated[
        float, described("a pose whose newest data is older is stale", "s", gt=0)
    ] = 1.0
    dead_reckoning_after_gates: Annotated[
        float,
        described(
            "freshness is dead_reckoning after driving this many gates without a weighed scan",
            "gates",
            gt=1,
        ),
    ] = 5.0
    snapshot_every_steps: Annotated[
        int, described("interval of a worker's state snapshots", "steps", gt=0)
    ] = 10
    standby: Annotated[
        bool, described("wait while the robot has a coordinator, and take over when it fails")
    ] = False
    take_over_after_s: Annotated[
        float, described("time without a sign of life after which a coordinator is dead", "s", gt=0)
    ] = 2.0
    state_folder: Annotated[
        str,
        described(
            "folder for the state, with which a restarted coordinator continues; empty: the user's "
            "state folder; off: none"
        ),
    ] = ""
    last_pose_probability: Annotated[
        float,
        described("probability of the last place after the first search; 0: none", ge=0, le=0.5),
    ] = 0.1
    keep_pose_on_new_map: Annotated[
        bool,
        described(
            "a new map shows the same place: start in it from the poses in the old one; false: "
            "search the whole new map"
        ),
    ] = False


class WorkerSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Worker processes of this machine."""

    count: Annotated[
        int,
        described("worker processes; 0: as many as have work, from 2 to one for each core", ge=0),
    ] = 0
    cache_folder: Annotated[
        str, described("folder for likelihood fields; empty: the user's cache folder")
    ] = ""


class LogSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The log on standard error."""

    level: Annotated[
        Literal["debug", "info", "warning", "error"], described("least severe message shown")
    ] = "info"


class RecorderSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The flight recorder of the coordinator, for `clustermcl replay`."""

    folder: Annotated[
        str,
        described(
            "folder for the coordinator's input, one subfolder per robot; empty: none, but with "
            "`clustermcl up` the user's state folder; off: none"
        ),
    ] = ""
    max_mb: Annotated[
        float, described("size of a robot's recording; the oldest files are deleted", "MB", ge=1)
    ] = 50.0


class MetricsSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Prometheus metrics, served by the coordinator."""

    port: Annotated[int, described("port of /metrics; 0: not served", ge=0, le=65535)] = 0
    host: Annotated[str, described("address of this machine to listen on")] = "127.0.0.1"


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
