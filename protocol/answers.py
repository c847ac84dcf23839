"""Answers from the coordinator to everybody, and the commands that a person gives."""

from typing import Literal, TypeAlias

import msgspec

from protocol.health import Health
from protocol.live_settings import AS_STARTED, LiveSettings
from protocol.message import Circle, Covariance, Message, PoseTuple

State: TypeAlias = Literal["searching", "ambiguous", "localized", "lost"]
"""`searching`: no place is known, or the most probable one was given and no scan has confirmed it.
`ambiguous`: several are possible. `localized`: one is all but certain. `lost`: none is probable."""
Freshness: TypeAlias = Literal["fresh", "blind", "stale", "none"]
"""`fresh`: odometry and scans arrive. `blind`: odometry alone moves the pose, for the robot has
driven on without a step, or no worker is left. `stale`: nothing new has arrived for a while.
`none`: no scan has been seen yet; then there is no pose either."""


class Hypothesis(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One place where the robot may be."""

    cluster: int
    """Its cluster, of the same number for life; negative: a place of a search that goes on."""
    probability: float
    """That the robot is there."""
    log_probability: float
    """Its natural logarithm, which does not underflow."""
    mean: PoseTuple
    """Pose of the robot in the map: x [m], y [m], heading [rad]."""
    covariance: Covariance
    """Of that pose, row by row."""
    effective_sample_size: float
    """Of its particles: how many equally weighted ones tell as much."""
    age_steps: int
    """Steps since the cluster entered the belief."""


class Belief(Message, frozen=True, kw_only=True, tag="belief/1"):
    """The belief after one step. From the coordinator on ``belief``; the next repairs a loss."""

    step: int
    """Number of the step; rises by one."""
    stamp_ns: int
    """Robot's clock at the step's scan."""
    odom_from_robot: PoseTuple
    """Odometry at that scan: x [m], y [m], heading [rad]."""
    state: State
    """What the probabilities amount to; docs/operations.md explains each state."""
    hypotheses: tuple[Hypothesis, ...]
    """Most probable first; with `elsewhere_probability` they sum to 1."""
    searching: bool
    """A global search is under way."""
    missing: tuple[str, ...] = ()
    """Jobs whose report did not arrive in time."""
    last: bool = False
    """The recording, or the simulated run, ends with this step."""
    term: int = 0
    """The coordinator's term: a belief of a lower one than was heard before is of the past."""
    elsewhere_probability: float = 0.0
    """That the robot is at none of these places."""
    search_progress: float = 0.0
    """How near the search that runs is to its end, 0 to 1."""
    off_map_probability: float = 0.0
    """Of `elsewhere_probability`, that the robot is not on this map at all."""

    @property
    def pose(self) -> PoseTuple | None:
        """The most probable place: x [m], y [m], heading [rad]; None: there is none yet."""
        return self.hypotheses[0].mean if self.hypotheses else None

    @property
    def covariance(self) -> Covariance | None:
        """Of `pose`, row by row."""
        return self.hypotheses[0].covariance if self.hypotheses else None

    @property
    def probability(self) -> float:
        """That the robot is at `pose`."""
        return self.hypotheses[0].probability if self.hypotheses else 0.0


class PoseAnswer(Message, frozen=True, kw_only=True, tag="pose/1"):
    """Where the robot is now. Published on ``pose`` each step; answers queries on ``pose``."""

    state: State
    """Of the belief after its last step."""
    freshness: Freshness
    """Whether data still arrives; steer by it."""
    stamp_ns: int
    """Robot's clock at the odometry that carried the pose forward."""
    age_s: float
    """Since that odometry arrived, by the coordinator's clock; -1 for `none`. What has come later
    than usual by a live robot's stamps counts from when it should have come."""
    step: int
    """Number of the last step; -1 before the first."""
    probability: float
    """Of the most probable place, which is the pose."""
    map_from_robot: PoseTuple | None
    """The pose: x [m], y [m], heading [rad]; None: no place is tracked yet."""
    covariance: Covariance | None
    """Of the pose, row by row; None without a pose."""
    workers: int
    """Workers alive; 0 means the belief does not follow the robot's scans."""
    term: int = 0
    """The coordinator's term."""
    scan_age_s: float = -1.0
    """Since the newest scan arrived that a worker weighed, counted as `age_s`; -1: none was."""
    elsewhere_probability: float = 1.0
    """That the robot is at none of the places that are tracked."""
    off_map_probability: float = 0.0
    """As in `Belief`."""


class Hypotheses(Message, frozen=True, kw_only=True, tag="hypotheses/1"):
    """All places with their probabilities, carried forward by odometry. Answers ``hypotheses``."""

    pose: PoseAnswer
    """The answer to `pose`, of the same moment."""
    hypotheses: tuple[Hypothesis, ...]
    """Most probable first."""


class Status(Message, frozen=True, kw_only=True, tag="status/1"):
    """How the system is. Answers queries on ``status``."""

    version: str
    """The coordinator's."""
    state: State
    """As in `PoseAnswer`."""
    freshness: Freshness
    """As in `PoseAnswer`."""
    age_s: float
    """As in `PoseAnswer`."""
    step: int
    """Number of the last step that was applied; -1 before the first."""
    steps_applied: int
    """Since this coordinator began."""
    steps_lost: int
    """Steps whose scan never came, or that were applied without one report."""
    reports_missing: int
    """Reports of workers that did not come in time."""
    map_digest: str
    """Names the map; empty while it is not known."""
    clusters: int
    """Places that are tracked."""
    searching: bool
    """A global search is under way."""
    workers: dict[str, tuple[str, ...]]
    """Name of each live worker to its jobs."""
    counters: dict[str, int]
    """Everything that was dropped or refused, by cause."""
    uptime_s: float
    """Since the coordinator was started."""
    term: int = 0
    """The coordinator's term."""
    processes: tuple[Health, ...] = ()
    """How each process is, the coordinator first; silent ones are left out after 30 s."""
    scan_age_s: float = -1.0
    """As in `PoseAnswer`."""
    overloaded: bool = False
    """Steps are made faster than they are decided: scans are left out, searches put off."""
    newest_step: int = -1
    """The newest whose scan has arrived, applied or not: a bridge that starts goes on after it."""
    search_progress: float = 0.0
    """As in `Belief`."""
    settings: LiveSettings = AS_STARTED
    """Of the newest scan."""


class SetPose(Message, frozen=True, kw_only=True, tag="set_pose/1"):
    """A person says where the robot is. A query on ``command/set_pose``.

    Refused where the map has no free ground within 3 sigma. Before the first scan, or the map, it
    is remembered until then, as `Relocalize` is: the last of both counts.
    """

    command_id: str
    """The same id again does nothing."""
    map_from_robot: PoseTuple
    """x [m], y [m], heading [rad]."""
    position_sigma_m: float = 0.5
    """Standard deviation of x and of y."""
    heading_sigma_rad: float = 0.26
    """Standard deviation of the heading."""
    covariance: Covariance | None = None
    """Of the pose; it stands in for both sigmas."""
    stamp_ns: int | None = None
    """When the robot was there, by its own clock: the odometry since is added. None: now."""


class Relocalize(Message, frozen=True, kw_only=True, tag="relocalize/1"):
    """Forget the belief and search for the robot. A query on ``command/relocalize``."""

    command_id: str
    """The same id again does nothing."""
    near: Circle | None = None
    """Where to search; None: everywhere."""
    region: str = ""
    """Of the coordinator's settings: where to search; empty: everywhere."""


class Update(Message, frozen=True, kw_only=True, tag="update/1"):
    """Make a step of the next scan, also of a robot that stands. A query on ``command/update``.

    The bridge answers, before that step is made.
    """

    command_id: str
    """The same id again does nothing."""


class Configure(Message, frozen=True, kw_only=True, tag="configure/1"):
    """Change settings while the robot drives. A query on ``command/configure``.

    The bridge answers; they hold from its next step on, and are all that is live from then on.
    """

    settings: LiveSettings
    """All live settings, those that stay as they are included."""


class Kidnap(Message, frozen=True, kw_only=True, tag="kidnap/1"):
    """Lift the simulated robot to another place. A query on ``simulator/kidnap``."""

    command_id: str
    """The same id again does nothing."""
    map_from_robot: PoseTuple | None = None
    """Where to; None: somewhere far away."""


class Drive(Message, frozen=True, kw_only=True, tag="drive/1"):
    """Drive the simulated robot by hand. A query on ``simulator/drive``.

    Repeat it several times a second while it lasts: a second of the robot's time after the last
    one it stands still, and waits.
    """

    speed_m_s: float = 0.0
    """Forward; the robot goes as fast as it can, and hits nothing."""
    turn_rate_rad_s: float = 0.0
    """Counter-clockwise."""
    by_hand: bool = True
    """False: the robot wanders on by itself."""


class CommandDone(Message, frozen=True, kw_only=True, tag="command_done/1"):
    """Answer to a command."""

    problem: str = ""
    """Why it was refused; empty when it was done."""
