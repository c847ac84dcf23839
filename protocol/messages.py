"""Every message of the system: who sends it where, who reads it, what losing it costs.

All are frozen structures that `protocol.codec` turns into MessagePack maps and back. A field
never changes its name, type or unit; a new field has a default; anything else is a new version.
Poses are (x [m], y [m], heading [rad]). Keys stand relative to the robot's namespace; see
`protocol.keys`.
"""

from typing import Literal, TypeAlias

import msgspec

from protocol.arrays import ArrayBlob

PoseTuple: TypeAlias = tuple[float, float, float]
"""x [m], y [m], heading [rad]."""
Covariance: TypeAlias = tuple[float, float, float, float, float, float, float, float, float]
"""3 x 3, row by row, over x [m], y [m], heading [rad]."""
State: TypeAlias = Literal["searching", "ambiguous", "localized", "lost"]


class Message(msgspec.Struct, frozen=True, kw_only=True, tag_field="schema"):
    """What all messages have in common."""

    sender: str
    """Name of the process that speaks."""


# --- readings: from a robot to the bridge -------------------------------------------------------


class OdometryReading(Message, frozen=True, kw_only=True, tag="odometry_reading/1"):
    """One odometry pose. From a robot on ``readings/odometry``; the next one repairs a loss."""

    stamp_ns: int
    odom_from_robot: PoseTuple


class LaserReading(Message, frozen=True, kw_only=True, tag="laser_reading/1"):
    """One raw scan. From a robot on ``readings/laser``; losing one costs nothing but a step."""

    stamp_ns: int
    ranges: ArrayBlob
    """(B,) float32 [m], counter-clockwise; not finite, <= 0 or >= range_max_m: no return."""
    angle_min_rad: float
    """Direction of the first beam in the laser's frame."""
    angle_step_rad: float
    range_max_m: float
    robot_from_laser: PoseTuple
    odom_from_robot: PoseTuple | None = None
    """Odometry at the scan's time, where the source knows it; else it is interpolated."""


# --- steps: from the bridge to everybody --------------------------------------------------------


class Scan(Message, frozen=True, kw_only=True, tag="scan/1"):
    """One step: a gated scan with the odometry pose at its time.

    Sent by the bridge on ``scan``, in the order of the steps; read by workers and coordinator.
    A worker that loses one moves by the difference of odometry and loses that step's evidence.
    """

    step: int
    stamp_ns: int
    odom_from_robot: PoseTuple
    robot_from_laser: PoseTuple
    angle_min_rad: float
    angle_step_rad: float
    range_max_m: float
    ranges: ArrayBlob
    """(B,) float32 [m], counter-clockwise; not finite, <= 0 or >= range_max_m: no return."""
    map_digest: str
    paced: bool = False
    """The bridge sends the next step only when this one's belief is out."""
    last: bool = False
    """The recording ends here."""


class ScanHistory(Message, frozen=True, kw_only=True, tag="scan_history/1"):
    """Steps of the past. The bridge's answer to a query on ``scans``; ask again after a loss."""

    scans: tuple[Scan, ...]
    """In the order of the steps; older ones than the bridge keeps are missing."""


class MapMessage(Message, frozen=True, kw_only=True, tag="map/1"):
    """The map. The bridge's answer to a query on ``map``; ask again after a loss."""

    digest: str
    cell_m: float
    map_from_grid: PoseTuple
    """Pose of the low corner of cell [0, 0] in the map frame."""
    rows: int
    cols: int
    zlib_cells: bytes
    """zlib of rows x cols int8, row 0 has the lowest y: 0 free, 1 occupied, -1 unknown."""


class TruePose(Message, frozen=True, kw_only=True, tag="true_pose/1"):
    """Where the simulated robot really is. From the simulator on ``truth``, once a step."""

    step: int
    map_from_robot: PoseTuple


# --- work: from the coordinator to workers, and back --------------------------------------------


class Particles(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A weighted cloud as it was after one step."""

    step: int
    odom_from_robot: PoseTuple
    map_from_robot: ArrayBlob
    """(N, 3) x [m], y [m], heading [rad]."""
    log_weights: ArrayBlob
    """(N,) of any common scale."""


class TrackJob(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="kind",
    tag="track",
):
    """Track one cluster from a cloud on."""

    cluster: int
    start: Particles
    exact: bool
    """Carry on with just this cloud; else draw the cluster's own particles from it first."""


class SearchJob(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="kind",
    tag="search",
):
    """Run one shard of a global search."""

    search: int
    shard: int
    first_step: int
    """The first step whose scan it uses."""


class Assignment(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One job for one worker. The epoch rises each time a job changes hands."""

    job_id: str
    epoch: int
    job: TrackJob | SearchJob


class WorkOrder(Message, frozen=True, kw_only=True, tag="work_order/1"):
    """All that a worker shall do from now on: jobs it keeps and jobs it begins.

    A query of the coordinator on ``worker/{name}/order``, repeated until answered: the same
    order twice does nothing the second time. Jobs that it does not name end.
    """

    order: int
    """Rises with each order; a worker refuses one lower than the last."""
    map_digest: str
    filter_settings: dict[str, object]
    snapshot_every_steps: int
    keep: tuple[tuple[str, int], ...]
    """(job id, epoch) of jobs that go on."""
    begin: tuple[Assignment, ...]


class OrderAnswer(Message, frozen=True, kw_only=True, tag="order_answer/1"):
    """A worker's answer to a work order, or to a query on ``worker/{name}/state``."""

    order: int
    """The last order it follows."""
    incarnation: int
    """Start time of the process [ns]: another number is another process."""
    jobs: tuple[tuple[str, int, int], ...]
    """(job id, epoch, last step done)."""
    problem: str = ""
    """Why the order was refused; empty when it was taken."""


class Place(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One place that a search shard, or a cluster that has fallen apart, holds possible."""

    share: float
    """Its share of the shard's or the cluster's weight."""
    mean: PoseTuple
    covariance: Covariance
    sample: Particles
    """Particles drawn from it for the hand-over; one of a place too improbable to be taken over."""


class TrackReport(Message, frozen=True, kw_only=True, tag="track_report/1"):
    """What one cluster made of one scan. Losing one costs its cluster that step's update.

    Sent by a worker on ``worker/{name}/report`` for every step and job, in order; read by the
    coordinator.
    """

    job_id: str
    epoch: int
    step: int
    log_weight_sum: float
    """Log of the summed particle weights under the scan; weights summed to `particles` before."""
    particles: int
    log_likelihood_per_beam: float
    """Best particle's log-likelihood a beam, without exponent: how well the scan fits at all."""
    effective_sample_size: float
    mean: PoseTuple
    covariance: Covariance
    snapshot: Particles | None = None
    parts: tuple[Place, ...] = ()
    """Two or more where the cluster has fallen apart, most probable first."""


class SearchReport(Message, frozen=True, kw_only=True, tag="search_report/1"):
    """What one search shard holds possible after one step. Sent like a track report."""

    job_id: str
    epoch: int
    step: int
    log_evidence: float
    """Log of the average likelihood of all scans so far, over the whole free space."""
    particles: int
    annealed: bool
    """The likelihood exponent has reached its full value; before, no places are reported."""
    log_likelihood_per_beam: float
    places: tuple[Place, ...]
    """Most probable first."""


Report: TypeAlias = TrackReport | SearchReport


# --- answers: from the coordinator to everybody -------------------------------------------------


class Hypothesis(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One place where the robot may be."""

    cluster: int
    probability: float
    log_probability: float
    mean: PoseTuple
    covariance: Covariance
    effective_sample_size: float
    age_steps: int
    """Steps since the cluster entered the belief."""


class Belief(Message, frozen=True, kw_only=True, tag="belief/1"):
    """The belief after one step. From the coordinator on ``belief``; the next repairs a loss."""

    step: int
    stamp_ns: int
    odom_from_robot: PoseTuple
    state: State
    hypotheses: tuple[Hypothesis, ...]
    """Most probable first; probabilities sum to 1."""
    searching: bool
    """A global search is under way."""
    missing: tuple[str, ...] = ()
    """Jobs whose report did not arrive in time."""
    last: bool = False


class PoseAnswer(Message, frozen=True, kw_only=True, tag="pose/1"):
    """Where the robot is now. Published on ``pose`` each step; answers queries on ``pose``."""

    state: State
    freshness: Literal["fresh", "stale", "none"]
    """`none`: no scan has been seen yet; then there is no pose either."""
    stamp_ns: int
    """Robot's clock at the odometry that carried the pose forward."""
    age_s: float
    """Since that odometry arrived, by the coordinator's clock; -1 for `none`."""
    step: int
    probability: float
    map_from_robot: PoseTuple | None
    covariance: Covariance | None
    workers: int
    """Workers alive; 0 means the belief does not follow the robot's scans."""


class Hypotheses(Message, frozen=True, kw_only=True, tag="hypotheses/1"):
    """All places with their probabilities, carried forward by odometry. Answers ``hypotheses``."""

    pose: PoseAnswer
    hypotheses: tuple[Hypothesis, ...]


class Status(Message, frozen=True, kw_only=True, tag="status/1"):
    """How the system is. Answers queries on ``status``."""

    version: str
    state: State
    freshness: Literal["fresh", "stale", "none"]
    age_s: float
    step: int
    steps_applied: int
    steps_lost: int
    """Steps whose scan never came, or that were applied without one report."""
    reports_missing: int
    map_digest: str
    clusters: int
    searching: bool
    workers: dict[str, tuple[str, ...]]
    """Name of each live worker to its jobs."""
    counters: dict[str, int]
    """Everything that was dropped or refused, by cause."""
    uptime_s: float


class SetPose(Message, frozen=True, kw_only=True, tag="set_pose/1"):
    """A person says where the robot is. A query on ``command/set_pose``."""

    command_id: str
    """The same id again does nothing."""
    map_from_robot: PoseTuple
    position_sigma_m: float = 0.5
    heading_sigma_rad: float = 0.26


class Relocalize(Message, frozen=True, kw_only=True, tag="relocalize/1"):
    """Forget the belief and search everywhere. A query on ``command/relocalize``."""

    command_id: str


class Kidnap(Message, frozen=True, kw_only=True, tag="kidnap/1"):
    """Lift the simulated robot to another place. A query on ``simulator/kidnap``."""

    command_id: str
    """The same id again does nothing."""
    map_from_robot: PoseTuple | None = None
    """Where to; None: somewhere far away."""


class CommandDone(Message, frozen=True, kw_only=True, tag="command_done/1"):
    """Answer to a command."""

    problem: str = ""
    """Why it was refused; empty when it was done."""
