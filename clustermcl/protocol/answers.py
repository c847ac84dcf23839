"""The coordinator's publications and answers, and the commands that clients send."""

from __future__ import annotations  # `help` shows names of types, not their definitions

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from clustermcl.protocol import keys
from clustermcl.protocol.health import Health
from clustermcl.protocol.live_settings import AS_STARTED, LiveSettings
from clustermcl.protocol.message import (
    LIST_BYTES,
    Circle,
    Covariance,
    Id,
    Message,
    Part,
    PoseTuple,
    Stamp,
)
from clustermcl.protocol.why import Why

State: TypeAlias = Literal["searching", "ambiguous", "localized", "lost"]
"""`searching`: no place is known, or the most probable one was given and no scan was weighed there.
`ambiguous`: several places are possible. `localized`: one is almost certain. `lost`: none is
probable."""
Freshness: TypeAlias = Literal["fresh", "dead_reckoning", "stale", "none"]
"""`fresh`: odometry and scans arrive. `dead_reckoning`: the robot has driven on without a step, or
no worker is left. `stale`: no new data has arrived for a while. `none`: no scan has arrived yet,
so there is no pose either."""

MAX_FLOORS, MAX_FLOOR_CHARACTERS = 64, 64
"""Floors of a building, and characters of a floor's name."""
FloorName: TypeAlias = Annotated[str, Meta(max_length=MAX_FLOOR_CHARACTERS)]
FloorProbabilities: TypeAlias = Annotated[dict[FloorName, float], Meta(max_length=MAX_FLOORS)]
Sigma: TypeAlias = Annotated[float, Meta(gt=0.0, le=1e4)]


class HasPose:
    """The numbers of `pose` by name; each raises ValueError while there is no pose."""

    __slots__ = ()

    @property
    def x_m(self) -> float:
        """x in the map [m]."""
        return self._number(0)

    @property
    def y_m(self) -> float:
        """y in the map [m]."""
        return self._number(1)

    @property
    def heading_rad(self) -> float:
        """Heading in the map [rad]."""
        return self._number(2)

    def _number(self, index: int) -> float:
        pose: Sequence[float] | None = getattr(self, "pose")  # noqa: B009 - a field or a property
        if pose is None:
            raise ValueError("there is no pose yet: `pose` is None")
        return float(pose[index])


class Hypothesis(HasPose, Part, frozen=True, kw_only=True):
    """One place where the robot may be."""

    cluster: int
    """Number of its cluster, never reused; negative: a candidate of a running search."""
    probability: float
    """Probability that the robot is there: within `search.source_radius_m` along both axes of the
    ellipse of its position, and within `search.source_heading_rad`."""
    log_probability: float
    """Natural logarithm of `probability`; does not underflow."""
    pose: PoseTuple
    """Pose of the robot in the map: x [m], y [m], heading [rad]."""
    covariance: Covariance
    """Covariance of `pose`, row by row."""
    effective_sample_size: float
    """Number of equally weighted particles with the same information."""
    age_steps: int
    """Steps since the cluster entered the belief."""
    floor: FloorName = ""
    """The floor of `pose`, which is in the frame of that floor's map; empty for a single map."""


class Belief(HasPose, Message, frozen=True, kw_only=True, tag="belief/1"):
    """The belief after one step.

    Published by the coordinator on ``belief`` after each step; the next one repairs a loss.
    """

    max_bytes: ClassVar[int] = LIST_BYTES
    step: int
    """Number of the step; increases by one."""
    stamp_ns: int
    """Robot's clock at the step's scan."""
    odom_from_robot: PoseTuple
    """Odometry at that scan: x [m], y [m], heading [rad]."""
    state: State
    """Summary of the probabilities; docs/operations.md explains each state."""
    hypotheses: tuple[Hypothesis, ...]
    """Most probable first; with `elsewhere_probability` they sum to 1."""
    searching: bool
    """A global search is under way."""
    missing: tuple[str, ...] = ()
    """Jobs whose report did not arrive in time."""
    last: bool = False
    """The recording, or the simulated run, ends with this step."""
    term: int = 0
    """The coordinator's term. Discard a belief with a lower term than one already received."""
    elsewhere_probability: float = 0.0
    """Probability that the robot is at none of these places."""
    search_progress: float = 0.0
    """Progress of the running search, 0 to 1."""
    off_map_probability: float = 0.0
    """The part of `elsewhere_probability` that the robot is not on this map at all."""
    floors: FloorProbabilities = msgspec.field(default_factory=dict)
    """Probability of each floor: the sum over its places. Empty for a single map."""

    @property
    def floor(self) -> str:
        """The floor of `pose`; empty for a single map, and without a place."""
        return self.hypotheses[0].floor if self.hypotheses else ""

    why: Why = Why()
    """What changed the probabilities in this step; empty after a command."""

    @property
    def best(self) -> Hypothesis | None:
        """The most probable place; None: there is none yet."""
        return self.hypotheses[0] if self.hypotheses else None

    @property
    def pose(self) -> NDArray[np.float64] | None:
        """(3,) the most probable place: x [m], y [m], heading [rad]; None: there is none yet."""
        return np.array(self.hypotheses[0].pose) if self.hypotheses else None

    @property
    def covariance(self) -> NDArray[np.float64] | None:
        """(3, 3) covariance of `pose` [m², m rad, rad²]; None: there is no place yet."""
        return np.reshape(self.hypotheses[0].covariance, (3, 3)) if self.hypotheses else None

    @property
    def probability(self) -> float:
        """Probability that the robot is at `pose`."""
        return self.hypotheses[0].probability if self.hypotheses else 0.0

    def __repr__(self) -> str:
        at = ""
        if (best := self.best) is not None:
            x, y, heading = best.pose
            on = f" on floor {best.floor}" if best.floor else ""
            at = f", {best.probability:.1%} at ({x:.2f} m, {y:.2f} m, {heading:.2f} rad){on}"
        places = len(self.hypotheses)
        return f"<{type(self).__name__} of step {self.step}: {self.state}{at}, {places} places>"


class PoseAnswer(HasPose, Message, frozen=True, kw_only=True, tag="pose/1"):
    """The robot's present pose. Published on ``pose`` each step; answers queries on ``pose``."""

    state: State
    """State of the belief after its last step."""
    freshness: Freshness
    """Whether data still arrives; check it before steering by the pose."""
    stamp_ns: int
    """Robot's clock at the newest odometry, to which the pose is predicted."""
    age_s: float
    """Time since that odometry arrived, by the coordinator's clock; -1 for `none`. For a live
    robot, the delay beyond the usual latency is added."""
    step: int
    """Number of the last step; -1 before the first."""
    probability: float
    """Probability of the most probable place, which is the pose."""
    pose: PoseTuple | None
    """In the map: x [m], y [m], heading [rad]; None: no place is tracked yet."""
    covariance: Covariance | None
    """Covariance of the pose, row by row; None without a pose."""
    workers: int
    """Live workers; with 0 the belief does not follow the robot's scans."""
    term: int = 0
    """As in `Belief`."""
    scan_age_s: float = -1.0
    """Time since the newest scan that a worker weighed, measured like `age_s`; -1: none yet."""
    elsewhere_probability: float = 1.0
    """Probability that the robot is at none of the tracked places."""
    off_map_probability: float = 0.0
    """As in `Belief`."""
    floor: FloorName = ""
    """As in `Hypothesis`."""
    floors: FloorProbabilities = msgspec.field(default_factory=dict)
    """As in `Belief`."""


class Hypotheses(Message, frozen=True, kw_only=True, tag="hypotheses/1"):
    """All places with their probabilities, predicted by odometry. Answers ``hypotheses``."""

    max_bytes: ClassVar[int] = LIST_BYTES
    pose: PoseAnswer
    """The answer to `pose` at the same moment."""
    hypotheses: tuple[Hypothesis, ...]
    """Most probable first."""
    why: Why = Why()
    """As in `Belief`."""


class Status(Message, frozen=True, kw_only=True, tag="status/1"):
    """State of the system and its counters. Answers queries on ``status``."""

    max_bytes: ClassVar[int] = LIST_BYTES
    version: str
    """Version of the coordinator."""
    state: State
    """As in `PoseAnswer`."""
    freshness: Freshness
    """As in `PoseAnswer`."""
    age_s: float
    """As in `PoseAnswer`."""
    step: int
    """Number of the last step that was applied; -1 before the first."""
    steps_applied: int
    """Steps applied since this coordinator started."""
    steps_lost: int
    """Steps whose scan never arrived, or that were applied without any report."""
    reports_missing: int
    """Workers' reports that did not arrive in time."""
    map_digest: str
    """Identifies the map; empty while it is not known."""
    clusters: int
    """Number of tracked places."""
    searching: bool
    """A global search is under way."""
    workers: dict[str, tuple[str, ...]]
    """Maps each live worker's name to its jobs."""
    counters: dict[str, int]
    """Counts of dropped and refused things, by cause."""
    uptime_s: float
    """Time since the coordinator started."""
    term: int = 0
    """As in `Belief`."""
    processes: tuple[Health, ...] = ()
    """Health of each process, the coordinator first; silent ones are removed after 30 s."""
    scan_age_s: float = -1.0
    """As in `PoseAnswer`."""
    overloaded: bool = False
    """Steps arrive faster than they are applied: scans are dropped and searches postponed."""
    newest_step: int = -1
    """Newest step whose scan arrived; a restarted bridge continues after it."""
    search_progress: float = 0.0
    """As in `Belief`."""
    settings: LiveSettings = AS_STARTED
    """Live settings of the newest scan."""
    floors: FloorProbabilities = msgspec.field(default_factory=dict)
    """As in `Belief`."""


class SetPose(Message, frozen=True, kw_only=True, tag="set_pose/1"):
    """Set the robot's pose. A query on ``command/set_pose``.

    Refused where the map has no free space within 3 sigma. Before the first scan or the map
    arrives, the last `SetPose` or `Relocalize` is kept and applied then.
    """

    key: ClassVar[str] = keys.SET_POSE
    command_id: Id
    """Makes the command idempotent: a repeated id has no effect. All commands have one."""
    pose: PoseTuple
    """x [m], y [m], heading [rad]."""
    position_sigma_m: Sigma = 0.5
    """Standard deviation of x and of y."""
    heading_sigma_rad: Sigma = 0.26
    """Standard deviation of the heading."""
    covariance: Covariance | None = None
    """Covariance of the pose; replaces both sigmas."""
    stamp_ns: Stamp | None = None
    """Time of the pose by the robot's clock; the odometry since then is added. None: now."""
    floor: FloorName = ""
    """The floor of the pose; a building of several floors needs it."""


class Relocalize(Message, frozen=True, kw_only=True, tag="relocalize/1"):
    """Forget the belief and search for the robot. A query on ``command/relocalize``."""

    key: ClassVar[str] = keys.RELOCALIZE
    command_id: Id
    """As in `SetPose`."""
    near: Circle | None = None
    """Search in this circle only; None: everywhere."""
    floor: FloorName = ""
    """The floor of `near`, or to search without it; empty: all floors."""


class Update(Message, frozen=True, kw_only=True, tag="update/1"):
    """Turn the next scan into a step even if the robot stands. A query on ``command/update``.

    The bridge answers before that step is made.
    """

    key: ClassVar[str] = keys.UPDATE
    command_id: Id
    """As in `SetPose`."""


class Configure(Message, frozen=True, kw_only=True, tag="configure/1"):
    """Change settings while the robot drives. A query on ``command/configure``.

    The bridge answers. The settings apply from its next step and replace all earlier ones.
    """

    key: ClassVar[str] = keys.CONFIGURE
    settings: LiveSettings
    """All live settings, including unchanged ones."""


class Kidnap(Message, frozen=True, kw_only=True, tag="kidnap/1"):
    """Move the simulated robot without odometry. A query on ``simulator/kidnap``."""

    key: ClassVar[str] = keys.KIDNAP
    command_id: Id
    """As in `SetPose`."""
    pose: PoseTuple | None = None
    """Its new pose; None: a random one far away."""


class CommandDone(Message, frozen=True, kw_only=True, tag="command_done/1"):
    """The coordinator's answer to a command."""

    problem: str = ""
    """Why it was refused; empty: it was carried out."""
