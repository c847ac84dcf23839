"""Work orders from the coordinator to workers, and the workers' reports."""

from collections.abc import Sequence
from typing import Annotated, ClassVar, TypeAlias

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.found_places import FoundPlaces
from clustermcl.protocol.message import (
    LARGEST_BYTES,
    Circle,
    Corners,
    Covariance,
    Finite,
    Id,
    Message,
    NotNegative,
    Number,
    NumberOrNone,
    Part,
    PoseTuple,
    Probability,
)

MAX_PARTICLES = 1_000_000
"""Particles of one cluster."""

ParticleCount: TypeAlias = Annotated[int, Meta(gt=0, le=MAX_PARTICLES)]
"""A number of particles that a cluster can have."""


class Particles(Part, frozen=True, kw_only=True):
    """A weighted particle set after one step."""

    step: Number
    odom_from_robot: PoseTuple
    map_from_robot: ArrayBlob
    """(N, 3) x [m], y [m], heading [rad]."""
    log_weights: ArrayBlob
    """(N,) log weights, not normalised."""

    def resampled(self, count: int) -> NDArray[np.float64]:
        """Return (count, 3) poses by systematic resampling without a random offset."""
        log_weights = self.log_weights.array()
        summed = np.cumsum(np.exp(log_weights - log_weights.max(), dtype=np.float64))
        marks = (np.arange(count) + 0.5) / count * summed[-1]
        chosen: NDArray[np.float64] = self.map_from_robot.array()[np.searchsorted(summed, marks)]
        return chosen.astype(np.float64)


class TrackJob(Part, frozen=True, kw_only=True, tag_field="kind", tag="track"):
    """Track one cluster, starting from a particle set."""

    cluster: Number
    start: Particles
    exact: bool
    """Use `start` unchanged; otherwise draw the cluster's particles from it first."""
    particles: ParticleCount | None = None
    """How many track it; None: the number in the settings."""
    particles_from: NumberOrNone = -1
    """An exact start is resampled to `particles` at this step or later, when it next resamples."""
    mirrored: bool = False
    """Use the mirrored scans: the job of a decoy."""


class SearchJob(Part, frozen=True, kw_only=True, tag_field="kind", tag="search"):
    """Run one shard of a global search."""

    search: Number
    shard: Number
    first_step: NumberOrNone
    """The first step whose scan it uses."""
    near: Circle | None = None
    """Search in this circle only; None: everywhere."""
    corners: Corners | None = None
    """Search in this rectangle of an atlas only; None: everywhere."""
    mirrored: bool = False
    """Use the mirrored scans: the job of a decoy."""


class ElsewhereJob(Part, frozen=True, kw_only=True, tag_field="kind", tag="elsewhere"):
    """Compute each scan's likelihood, averaged over poses spread evenly over the whole map."""

    first_step: NumberOrNone
    """The first step whose scan it weighs."""


Job: TypeAlias = TrackJob | SearchJob | ElsewhereJob


class Assignment(Part, frozen=True, kw_only=True):
    """One job for one worker. The epoch increases each time another worker gets the job."""

    job_id: Id
    epoch: Number
    job: Job
    term: Number = 0
    """Term of the coordinator that assigned it; another one may have used the same job id."""


class WorkOrder(Message, frozen=True, kw_only=True, tag="work_order/1"):
    """All jobs of a worker: those to keep and those to begin. Jobs not named end.

    A query of the coordinator on ``worker/{name}/order``, repeated until answered; a repeated
    order has no effect.
    """

    max_bytes: ClassVar[int] = LARGEST_BYTES
    order: Number
    """Increases with each order of a term; a worker ignores an order older than its last one."""
    term: Number = 0
    """The coordinator's term; a worker refuses a lower term than the highest it knows."""
    map_digest: str
    filter_settings: dict[str, object]
    snapshot_every_steps: Number
    keep: tuple[tuple[str, Number], ...]
    """(job id, epoch) of jobs to continue."""
    begin: tuple[Assignment, ...]
    resize: tuple[tuple[str, ParticleCount, NumberOrNone], ...] = ()
    """(job id, `particles`, `particles_from`) of clusters to continue with another number, as in
    `TrackJob`."""
    repeat_after: NumberOrNone | None = None
    """Reports on later steps may be lost, so they are sent again; None: none was lost. At the first
    order of a term, searches repeat older ones too."""


class OrderAnswer(Message, frozen=True, kw_only=True, tag="order_answer/1"):
    """A worker's answer to a work order."""

    order: Number
    """The last order that the worker accepted."""
    jobs: tuple[tuple[str, Number, NumberOrNone], ...]
    """(job id, epoch, last completed step)."""
    problem: str = ""
    """Why the order was refused; empty: it was accepted."""
    term: Number = 0
    """The highest term that the worker knows."""


class Place(Part, frozen=True, kw_only=True):
    """One place where the robot may be, with particles to start a cluster from.

    It is a result of a search, a part of a cluster that split, or a given pose.
    """

    share: Probability
    """Its share of the weight of its search or cluster; of a candidate cluster, the probability."""
    pose: PoseTuple
    covariance: Covariance
    sample: Particles
    """Particles drawn from the place."""


class TrackReport(Message, frozen=True, kw_only=True, tag="track_report/3"):
    """The result of one cluster for one scan.

    Published by a worker on ``worker/{name}/report`` for every step and job, in order; read by the
    coordinator. Losing one costs its cluster that step's update.
    """

    max_bytes: ClassVar[int] = LARGEST_BYTES
    job_id: Id
    epoch: Number
    step: Number
    log_weight_sum: Finite
    """Log of the sum of the weights after the update; before it they summed to `particles`."""
    particles: Annotated[int, Meta(ge=1)]
    effective_sample_size: NotNegative
    pose: PoseTuple
    covariance: Covariance
    fits: Annotated[bytes, Meta(max_length=65_536)] = b""
    """How well each beam fits at the most probable particle: see `beam_fits`."""
    log_observed: Finite = 0.0
    """Log of the average likelihood ratio of the step's observations, after the scan."""
    snapshot: Particles | None = None

    @property
    def cluster(self) -> int | None:
        """Number of the cluster that the job tracks; None: the id is not of such a job."""
        number = self.job_id.removeprefix("c")
        return int(number) if number.isascii() and number.isdigit() and len(number) < 16 else None


class SearchReport(Message, frozen=True, kw_only=True, tag="search_report/2"):
    """The places that a search shard considers possible after a step. Sent like `TrackReport`."""

    max_bytes: ClassVar[int] = LARGEST_BYTES
    job_id: Id
    epoch: Number
    step: Number
    log_evidence: Finite
    """Log of the average likelihood of the search's scans over the shard's part of the free space;
    all parts have the same size."""
    particles: Annotated[int, Meta(ge=1)]
    left_out_gap: Finite
    """Lower bound of the log ratio of the weight that the shard keeps to what it left out [nat]."""
    places: FoundPlaces


class ElsewhereReport(Message, frozen=True, kw_only=True, tag="elsewhere_report/2"):
    """A scan's likelihood over the whole map. Sent like `TrackReport`."""

    max_bytes: ClassVar[int] = LARGEST_BYTES
    job_id: Id
    epoch: Number
    step: Number
    log_likelihood: Finite
    """Log of the average likelihood of poses spread evenly over the free space, on the scale of the
    clusters' likelihoods."""
    log_observed: Finite = 0.0
    """Log of the average likelihood ratio of the step's observations over the free space, or more
    where places that they allow also fit the scan."""
    seen: ArrayBlob | None = None
    """(B, 2) ends of the beams, in the robot's frame [m]."""
    places: FoundPlaces | None = None
    """Places that the observations allow, with their shares of elsewhere; None: no observation."""


Report: TypeAlias = TrackReport | SearchReport | ElsewhereReport
MAX_BATCH = 64
"""Reports of one message: some 40 kB."""


class ReportBatch(Message, frozen=True, kw_only=True, tag="report_batch/1"):
    """Several reports of a worker that have no particles, in their order. Sent like `TrackReport`.

    Losing one costs each cluster in it that step's update.
    """

    reports: Annotated[
        tuple[TrackReport | ElsewhereReport, ...], Meta(min_length=2, max_length=MAX_BATCH)
    ]


Reported: TypeAlias = Report | ReportBatch
"""What a worker publishes as its report."""


def reports_in(message: Reported) -> tuple[Report, ...]:
    """Return the reports of a message in their order."""
    return message.reports if isinstance(message, ReportBatch) else (message,)


def in_few_messages(reports: Sequence[Report]) -> list[Reported]:
    """Return messages with these reports: consecutive ones without particles share a message.

    The page and the ROS bridge read the particles, and so need not read a batch.
    """
    messages, batch = list[Reported](), list[TrackReport | ElsewhereReport]()

    def close() -> None:
        if len(batch) > 1:
            messages.append(ReportBatch(sender=batch[0].sender, reports=tuple(batch)))
        else:
            messages.extend(batch)
        batch.clear()

    for report in reports:
        match report:
            case TrackReport(snapshot=None) | ElsewhereReport(places=None):
                batch.append(report)
            case _:
                close()
                messages.append(report)
        if len(batch) == MAX_BATCH:
            close()
    close()
    return messages


# --- fail-over to another coordinator -----------------------------------------------------------


class Checkpoint(Message, frozen=True, kw_only=True, tag="checkpoint/1"):
    """The coordinator's state, except for the particles, which the workers have.

    Published by the coordinator on ``checkpoint`` after each step, before its belief, and at
    least twice a second as a sign of life. Standby coordinators keep the newest, workers its
    term. Losing one costs nothing: later steps are applied again from the workers' reports.
    """

    max_bytes: ClassVar[int] = LARGEST_BYTES
    term: Number
    """Start of the coordinator's term [us of its clock]; higher than all earlier terms."""
    serial: Number
    """Increases with each change of the state in a term."""
    step: NumberOrNone
    """The last step applied; -1: none."""
    founded: bool
    """The belief has had clusters. A checkpoint without them never replaces one with them."""
    state: bytes
    """MessagePack that only a coordinator reads; see `clustermcl.coordinator.checkpoint`."""

    @property
    def rank(self) -> tuple[bool, int, int]:
        """Sort key: a new coordinator recovers from the checkpoint of the highest rank."""
        return (self.founded, self.term, self.serial)


class TakeOver(Message, frozen=True, kw_only=True, tag="take_over/1"):
    """A new coordinator takes over: the worker refuses orders of lower terms from then on.

    A query on ``worker/{name}/state``, repeated until answered.
    """

    term: Number


class WorkerState(Message, frozen=True, kw_only=True, tag="worker_state/1"):
    """A worker's answer to a `TakeOver`: what a new coordinator needs to recover the state.

    Its reports follow with the first order.
    """

    max_bytes: ClassVar[int] = LARGEST_BYTES
    term: Number
    """The highest term that the worker knows, including that of the `TakeOver`."""
    holds: tuple[Assignment, ...]
    """Its jobs, each with the state from which another worker could continue."""
    terms: tuple[Number, ...] = ()
    """All terms that the worker has received, including those of coordinators still recovering."""
    founded: Number = 0
    """The highest term of a received checkpoint with clusters; 0: none."""


MAX_AHEAD_US = 100 * 365 * 86_400 * 1_000_000
"""How far a term may be ahead of the local clock [us]: a machine without a battery starts in 1970
and must accept a term of today. The limit of valid terms, `2**53`, is the year 2255."""
MAX_RELAYED_AHEAD_US = 3 * MAX_AHEAD_US // 4
"""The same for a term that a worker relays, so that a new coordinator can choose a higher one."""


def check_term(
    message: WorkOrder | OrderAnswer | Checkpoint | TakeOver | WorkerState, clock_ns: int
) -> None:
    """Raise `MalformedMessageError` for a term too far ahead of the clock, the time since 1970."""
    clock_us = clock_ns // 1_000
    is_relayed = isinstance(message, OrderAnswer | WorkerState)
    most_us = MAX_RELAYED_AHEAD_US if is_relayed else MAX_AHEAD_US
    if message.term > clock_us + most_us:
        years = most_us // (MAX_AHEAD_US // 100)
        raise MalformedMessageError(
            expected=type(message).__name__,
            problem=f"term {message.term} is over {years} years ahead of the clock, {clock_us}",
            kind="term far ahead",
        )
