"""The state that a coordinator transfers to its successor, without particles.

A `Checkpoint` carries the state as MessagePack that only coordinators read. So its form may change
with each `STATE_VERSION`; a state of another version is refused.
"""

import math
from typing import Annotated

import msgspec
from msgspec import Meta

from coordinator.belief.cluster_set import Cluster
from coordinator.belief.ensemble import ELSEWHERE, Ensemble
from coordinator.belief.search_course import SearchCourse
from coordinator.belief.search_pool import SearchPool
from coordinator.commands import Commands
from coordinator.jobs import Jobs, PlacedJob
from coordinator.part import FEW, Count, Text, handed_on
from coordinator.step_collector import StepCollector
from protocol.codec import refusal_of
from protocol.errors import MalformedMessageError
from protocol.steps import Scan
from protocol.validity import assignment_problem, drawable_problem, first_problem
from protocol.work import Assignment, Checkpoint, ElsewhereJob, SearchJob, TrackJob

MAX_AGE_S = 1e9
Age = Annotated[float, Meta(ge=-1.0, le=MAX_AGE_S)]
SUM_TOLERANCE = 1e-6
"""Tolerance of a sum of probabilities; the rounding error of 10,000 clusters is below 1e-12."""


def ensemble_problem(ensemble: Ensemble, applied: Scan | None) -> str | None:
    """Return why a belief is impossible after the step `applied`; None: it is possible."""
    clusters, decoy = ensemble.clusters, ensemble.decoy
    if clusters.clusters and applied is None:
        return "no cluster can be tracked before the first step"
    for number, cluster in clusters.clusters.items():
        if not number == cluster.cluster < clusters.next_cluster:
            return "a cluster whose number was never assigned"
    if any(cluster.mirrored for cluster in clusters.all()):
        return "a decoy among the clusters"
    if not all(place.mirrored for place in decoy.places):
        return "a decoy that follows the robot itself"
    probabilities = (cluster.probability for cluster in clusters.all())
    if abs(math.fsum(probabilities) + clusters.outside_clusters - 1) > SUM_TOLERANCE:
        return "probabilities that do not sum to one"
    prior = ensemble.prior_pose
    return (
        first_problem(_cluster_problem(one, applied) for one in (*clusters.all(), *decoy.places))
        or first_problem(_search_problem(one, applied) for one in (ensemble.search, decoy.search))
        or (drawable_problem(prior.pose, prior.covariance) if prior else None)
        or ensemble.seen.problem
    )


def _cluster_problem(cluster: Cluster, applied: Scan | None) -> str | None:
    if cluster.born_step > (applied.step if applied else -1):
        return f"a cluster of step {cluster.born_step}"
    return drawable_problem(cluster.pose, cluster.covariance)


def _search_problem(course: SearchCourse, applied: Scan | None) -> str | None:
    pool = course.pool
    if pool is not None and pool.search >= course.begun:
        return f"search {pool.search} has never begun"
    if pool is not None and applied is not None and pool.first_step > applied.step + 1:
        return f"a search that begins at step {pool.first_step}"
    return None


def jobs_problem(jobs: Jobs, ensemble: Ensemble, applied: Scan | None) -> str | None:
    """Return why jobs do not fit a belief, in which each cluster has a job; None: they fit."""
    tracked = {*ensemble.clusters.job_ids, *ensemble.decoy.track_ids}
    if tracked - set(jobs.placed):
        return "a cluster that has no job"
    pools = (ensemble.search.pool, ensemble.decoy.search.pool)
    return first_problem(
        _job_problem(job_id, placed, tracked, pools, applied)
        for job_id, placed in jobs.placed.items()
    )


def _job_problem(
    job_id: str,
    placed: PlacedJob,
    tracked: set[str],
    pools: tuple[SearchPool | None, SearchPool | None],
    applied: Scan | None,
) -> str | None:
    job = placed.job
    match job:
        case None:
            fits = job_id in tracked
        case TrackJob():
            kind = "d" if job.mirrored else "c"
            fits = job_id in tracked and job_id == f"{kind}{job.cluster}"
        case ElsewhereJob():
            due = applied is None or job.first_step <= applied.step + 1
            fits = job_id == ELSEWHERE and due
        case SearchJob():
            pool, kind = pools[job.mirrored], "m" if job.mirrored else "s"
            begun = pool and (pool.search, pool.first_step) == (job.search, job.first_step)
            fits = bool(begun) and job_id == f"{kind}{job.search}.{job.shard}"
    if not fits:
        return "a job that has no cluster, no search and no step"
    if job is None:
        return None
    return assignment_problem(Assignment(job_id=job_id, epoch=placed.epoch, job=job))


def commands_problem(commands: Commands) -> str | None:
    """Return why the waiting command is invalid; None: it is valid, or no command waits."""
    return refusal_of(commands.waiting.command) if commands.waiting else None


def _scan_problem(scan: Scan) -> str | None:
    """Return why the ranges of a scan, with or without beams, are invalid; None: they are valid."""
    try:
        blobs = (scan.ranges, *(laser.ranges for laser in scan.others))
        shapes = [ranges.array().shape for ranges in blobs]
    except MalformedMessageError as error:
        return error.problem
    return None if all(len(shape) == 1 for shape in shapes) else f"ranges of {shapes}"


STATE_VERSION = 7


class CheckpointState(msgspec.Struct, frozen=True):
    """The part of a coordinator's state from which another one continues."""

    version: int
    map_digest: Text
    ensemble: Ensemble
    jobs: Jobs
    collector: StepCollector
    commands: Commands
    missing: Annotated[tuple[Text, ...], FEW]
    """Jobs that did not report the last applied step in time."""
    age_s: Age
    """Age of a live robot's applied scan, otherwise of the newest data [s]; -1: there is none."""
    age_known: bool
    """Whether the coordinator has received data itself; otherwise the age is only an estimate."""
    steps_applied: Count
    reports_missing: Count
    counters: Annotated[dict[Text, Count], FEW]


def to_bytes(state: CheckpointState) -> bytes:
    fields = {name: handed_on(getattr(state, name)) for name in state.__struct_fields__}
    return msgspec.msgpack.encode(fields)


def from_bytes(data: bytes) -> CheckpointState:
    """Decode and check a state.

    Raises:
        ValueError: the state cannot be read, has another version, or contradicts itself.
    """
    try:
        version = _VERSIONS.decode(data).version
        if version != STATE_VERSION:
            raise ValueError(f"state of version {version}, expected {STATE_VERSION}")
        state = _STATES.decode(data)
        if to_bytes(state) != data:
            raise ValueError("a state that no coordinator has written")
    except (msgspec.DecodeError, msgspec.ValidationError, RecursionError) as error:
        raise ValueError(f"not a coordinator's state: {error}") from None
    applied = state.collector.applied
    problem = (
        (_scan_problem(applied) if applied else None)
        or ensemble_problem(state.ensemble, applied)
        or jobs_problem(state.jobs, state.ensemble, applied)
        or commands_problem(state.commands)
    )
    if problem:
        raise ValueError(problem)
    return state


def state_in(checkpoint: Checkpoint) -> CheckpointState:
    """Return the state in a checkpoint.

    Raises:
        ValueError: as for `from_bytes`, or the two belong to different steps.
    """
    state = from_bytes(checkpoint.state)
    applied = state.collector.applied
    if checkpoint.step != (applied.step if applied else -1):
        raise ValueError(f"a checkpoint of step {checkpoint.step} with another's state")
    return state


def arrival(checkpoint: Checkpoint, received_ns: int) -> tuple[int, int] | None:
    """Return the stamp and the arrival time of a live robot's applied scan [ns].

    The second time is by the clock of `received_ns`. None: no such scan was applied, its age is
    only an estimate, or the state cannot be read.
    """
    try:
        state = _STATES.decode(checkpoint.state)
    except (msgspec.DecodeError, msgspec.ValidationError, RecursionError):
        return None
    applied = state.collector.applied
    is_known = state.version == STATE_VERSION and state.age_known
    if not is_known or applied is None or not applied.live:
        return None
    return applied.stamp_ns, received_ns - int(max(state.age_s, 0.0) * 1e9)


class _Version(msgspec.Struct, frozen=True):
    version: int


# Made before any thread starts: msgspec prepares a type at its first use, and crashes if another
# thread, such as the flight recorder's, uses the type at the same time.
_VERSIONS = msgspec.msgpack.Decoder(_Version)
_STATES = msgspec.msgpack.Decoder(CheckpointState)
