"""All settings of the system, one frozen structure a part, with defaults, units and meanings."""

from typing import Annotated, Literal

import msgspec

from particle_filter.settings import FilterSettings, described
from process_runtime.ros2_settings import Ros2Settings
from protocol.names import LONGEST_NAME, NAME_PATTERN

ROBOT_VARIABLE, ROUTER_VARIABLE = "CLUSTERMCL_ROBOT", "CLUSTERMCL_ROUTER"
"""Environment variables in which commands and `Client` find `robot.name` and `zenoh.router`."""


class RobotSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which robot this process serves."""

    name: Annotated[
        str,
        described(
            "robot's name; keeps the keys of several robots apart on one router",
            pattern=NAME_PATTERN,
            max_length=LONGEST_NAME,
        ),
    ] = "robot"


class ZenohSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How processes meet. Every process is a client of one router."""

    router: Annotated[
        str, described("endpoint of the router: where it listens and where clients connect")
    ] = "tcp/127.0.0.1:7447"
    start_router: Annotated[
        bool,
        described("`clustermcl up` starts that router; else one is there, such as rmw_zenohd"),
    ] = True
    connect_timeout_s: Annotated[
        float, described("how long a command looks for the router", "s", gt=0)
    ] = 2.0
    query_timeout_s: Annotated[
        float, described("how long a query waits for its answer", "s", gt=0)
    ] = 1.0
    tls_ca_certificate: Annotated[
        str, described("for tls/: file of the authority that signed the certificates")
    ] = ""
    tls_certificate: Annotated[
        str, described("for tls/: file of this process's own certificate")
    ] = ""
    tls_private_key: Annotated[str, described("for tls/: file of the key of that certificate")] = ""


class BridgeSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """From readings to steps."""

    map: Annotated[
        str,
        described(
            "map file: map_server YAML or wean.dat, may be .gz or .xz; zenoh, or empty with "
            "ros2.enabled: the robot publishes it"
        ),
    ] = ""
    source: Annotated[
        str,
        described("a recording's path, sim:WORLD, sim:MAP.yaml, or zenoh (readings of a robot)"),
    ] = "zenoh"
    rate: Annotated[
        float,
        described(
            "speed of a recording: 1 real time, 2 twice as fast, 0 as the workers follow", ge=0
        ),
    ] = 1.0
    gate_distance_m: Annotated[
        float, described("a scan becomes a step after so much driving", "m", ge=0)
    ] = 0.2
    gate_turn_rad: Annotated[float, described("or after so much turning", "rad", ge=0)] = 0.2
    laser_x_m: Annotated[
        float, described("laser ahead of the robot's centre, where the source does not say", "m")
    ] = 0.0
    laser_y_m: Annotated[
        float, described("laser left of the robot's centre, where the source does not say", "m")
    ] = 0.0
    laser_heading_rad: Annotated[
        float, described("laser's heading, where the source does not say", "rad")
    ] = 0.0
    scan_topic: Annotated[
        str, described("of a ROS bag: the laser's topic; empty: the only one there is")
    ] = ""
    odom_topic: Annotated[
        str, described("of a ROS bag: the topic of odometry; empty: odometry is tf's, if it has it")
    ] = ""
    odom_frame: Annotated[str, described("of a ROS bag: tf's frame of odometry; empty: odom")] = ""
    base_frame: Annotated[
        str, described("of a ROS bag: the robot's frame; empty: the one below that of odometry")
    ] = ""
    history_steps: Annotated[
        int, described("steps kept for workers that join late", "steps", gt=0)
    ] = 300


class CoordinatorSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """When the coordinator stops waiting, and who carries on after it."""

    step_deadline_s: Annotated[
        float, described("a step is applied at the latest so long after its scan", "s", gt=0)
    ] = 0.5
    paced_deadline_s: Annotated[
        float, described("the same when the bridge waits for the workers", "s", gt=0)
    ] = 20.0
    search_deadline_s: Annotated[
        float,
        described(
            "a step that all clusters have reported waits so long after its scan for a search; "
            "what that tells later counts with the next step",
            "s",
            ge=0,
        ),
    ] = 0.0
    stale_after_s: Annotated[
        float, described("a pose whose newest data is older is called stale", "s", gt=0)
    ] = 1.0
    blind_after_gates: Annotated[
        float,
        described(
            "a pose is called blind when the robot has driven so many times the bridge's gate "
            "since the last step",
            "gates",
            gt=1,
        ),
    ] = 5.0
    snapshot_every_steps: Annotated[
        int, described("a worker hands its state out every so many steps", "steps", gt=0)
    ] = 10
    standby: Annotated[
        bool, described("wait while the robot has a coordinator, and take over when it dies")
    ] = False
    take_over_after_s: Annotated[
        float, described("a coordinator that gives no sign of life for so long is dead", "s", gt=0)
    ] = 2.0
    state_folder: Annotated[
        str,
        described(
            "keeps the last pose of a live robot; empty: the user's state folder; off: nowhere"
        ),
    ] = ""
    save_pose_every_s: Annotated[
        float, described("the last pose is written at most so often; 0: never", "s", ge=0)
    ] = 5.0
    last_pose_probability: Annotated[
        float,
        described("given to the last pose when a first search ends; 0: none", ge=0, le=0.5),
    ] = 0.1
    keep_pose_on_new_map: Annotated[
        bool,
        described(
            "a new map is of the same place: poses in the old one are where to begin in it; else "
            "the robot is searched for everywhere"
        ),
    ] = False
    key_file: Annotated[
        str,
        described(
            "file with the key that the robot's coordinators alone have: they sign what workers "
            "keep for them, and believe nothing else; empty: nothing is signed"
        ),
    ] = ""


class WorkerSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Worker processes of this machine."""

    count: Annotated[int, described("worker processes", "", gt=0)] = 12
    cache_folder: Annotated[
        str, described("where likelihood fields are kept; empty: the user's cache folder")
    ] = ""


class LogSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is logged, on standard error."""

    level: Annotated[
        Literal["debug", "info", "warning", "error"], described("least severe message shown")
    ] = "info"
    trace_folder: Annotated[
        str, described("where each process writes when it did what in a step; empty: nowhere")
    ] = ""


class RecorderSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The flight recorder of the coordinator, for `clustermcl replay`."""

    folder: Annotated[
        str,
        described(
            "what the coordinator is told is recorded there, in a folder a robot; empty: nowhere, "
            "but with `clustermcl up` the user's state folder; off: nowhere"
        ),
    ] = ""
    max_mb: Annotated[
        float, described("of a robot's recording; the oldest files give way", "MB", ge=1)
    ] = 50.0


class MetricsSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Figures for Prometheus, served by the coordinator."""

    port: Annotated[int, described("port where /metrics is served; 0: nowhere", ge=0, le=65535)] = 0
    host: Annotated[str, described("address of this machine on which that port is opened")] = (
        "127.0.0.1"
    )


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
