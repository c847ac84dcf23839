"""Work from the coordinator to workers, and what they report back."""

from typing import TypeAlias

import msgspec

from protocol.arrays import ArrayBlob
from protocol.found_places import FoundPlaces
from protocol.message import Circle, Corners, Covariance, Message, PoseTuple


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
    particles: int | None = None
    """So many are drawn; None: as many as the settings say."""


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
    near: Circle | None = None
    """It looks there only; None: everywhere."""
    corners: Corners = ()
    """It looks within this region only; empty: everywhere."""


class ElsewhereJob(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="kind",
    tag="elsewhere",
):
    """Weigh each scan all over the map: how likely it is, wherever the robot may be."""

    first_step: int
    """The first step whose scan it weighs."""


Job: TypeAlias = TrackJob | SearchJob | ElsewhereJob


class Assignment(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One job for one worker. The epoch rises each time a job changes hands."""

    job_id: str
    epoch: int
    job: Job
    term: int = 0
    """Of the coordinator that gave it. Another that knew of nothing gave its own jobs such ids."""


class WorkOrder(Message, frozen=True, kw_only=True, tag="work_order/1"):
    """All that a worker shall do from now on: jobs it keeps and jobs it begins.

    A query of the coordinator on ``worker/{name}/order``, repeated until answered: the same
    order twice does nothing the second time. Jobs that it does not name end.
    """

    order: int
    """Rises with each order of a term; a worker leaves out one lower than the last."""
    term: int = 0
    """The coordinator's term; a worker refuses an order of a lower one than it knows."""
    map_digest: str
    filter_settings: dict[str, object]
    snapshot_every_steps: int
    keep: tuple[tuple[str, int], ...]
    """(job id, epoch) of jobs that go on."""
    begin: tuple[Assignment, ...]
    term_proof: bytes = b""
    """Who has the coordinators' key can tell by it that a coordinator has had this term."""


class OrderAnswer(Message, frozen=True, kw_only=True, tag="order_answer/1"):
    """A worker's answer to a work order, or to an empty query on ``worker/{name}/state``."""

    order: int
    """The last order it follows."""
    incarnation: int
    """Start time of the process [ns]: another number is another process."""
    jobs: tuple[tuple[str, int, int], ...]
    """(job id, epoch, last step done)."""
    problem: str = ""
    """Why the order was refused; empty when it was taken."""
    term: int = 0
    """The highest term that the worker knows."""
    term_proof: bytes = b""
    """As it came with that term."""


class Place(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One place where the robot may be, with particles from which it can be tracked.

    Found by a whole search, part of a cluster that has fallen apart, or given.
    """

    share: float
    """Of the weight of whatever holds it possible; where it asks to be tracked, its probability."""
    mean: PoseTuple
    covariance: Covariance
    sample: Particles
    """Particles drawn from it for the hand-over."""


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
    beam_classes: tuple[int, int, int, int] = (0, 0, 0, 0)
    """Beams at the best particle: how many end on an obstacle, near one, behind one, and others."""
    snapshot: Particles | None = None
    parts: tuple[Place, ...] = ()
    """Two or more where the cluster has fallen apart, most probable first."""


class SearchReport(Message, frozen=True, kw_only=True, tag="search_report/2"):
    """What one search shard holds possible after one step. Sent like a track report."""

    job_id: str
    epoch: int
    step: int
    log_evidence: float
    """Log of the average likelihood of all scans so far, over the shard's part of the free space:
    all shards have equal parts."""
    particles: int
    left_out_gap: float
    """Poses that the search has left out were worse than its best by so much at least [nat]."""
    log_likelihood_per_beam: float
    places: FoundPlaces


class ElsewhereReport(Message, frozen=True, kw_only=True, tag="elsewhere_report/1"):
    """How likely a scan is all over the map. Sent like a track report."""

    job_id: str
    epoch: int
    step: int
    log_likelihood: float
    """Log of the average likelihood of poses spread evenly over the free space, as of clusters."""


Report: TypeAlias = TrackReport | SearchReport | ElsewhereReport


# --- when a coordinator takes over from another -------------------------------------------------


class Checkpoint(Message, frozen=True, kw_only=True, tag="checkpoint/1"):
    """All that a coordinator would need to carry on, but for particles that workers hold.

    From the coordinator on ``checkpoint``, after each step before its belief, and at least twice
    a second, as a sign of life. Workers and standby coordinators keep the newest; losing one
    costs nothing, for the steps since are applied again from the workers' reports.
    """

    term: int
    """Start of the coordinator's rule [us of its clock], above all terms before."""
    serial: int
    """Rises with each change of the state in a term."""
    step: int
    """The last step applied; -1: none."""
    founded: bool
    """The belief has had clusters. One that has not replaces none that has."""
    state: bytes
    """MessagePack that only a coordinator reads; see `coordinator.checkpoint`."""
    term_proof: bytes = b""
    """Who has the coordinators' key can tell by it that a coordinator has had this term."""
    signature: bytes = b""
    """Of all of the above but the sender; see `coordinator.failover.trust`."""

    @property
    def rank(self) -> tuple[bool, int, int]:
        """Compares checkpoints: that of the highest rank is the one to carry on from."""
        return (self.founded, self.term, self.serial)


class TakeOver(Message, frozen=True, kw_only=True, tag="take_over/1"):
    """A coordinator begins to rule. A query of it on ``worker/{name}/state``, asked again.

    From then on the worker refuses orders of lower terms.
    """

    term: int
    term_proof: bytes = b""
    """Who has the coordinators' key can tell by it that a coordinator has had this term."""


class WorkerState(Message, frozen=True, kw_only=True, tag="worker_state/1"):
    """All that a worker can tell a new coordinator. Its answer to a `TakeOver`."""

    term: int
    """The highest term that the worker knows; the one asked for, where it was higher."""
    incarnation: int
    holds: tuple[Assignment, ...]
    """Its jobs, each from where another worker could carry on."""
    checkpoint: bytes
    """The newest that it has heard, as it came; empty: none."""
    reports: tuple[bytes, ...]
    """Its reports since the oldest of the checkpoints, as they went out; of searches, some
    before."""
    earlier: tuple[bytes, ...] = ()
    """Checkpoints to carry on from where the newest one is of no use, newest first."""
    term_proof: bytes = b""
    """As it came with the term."""
