"""The state of a coordinator as it is handed on: everything that decides, but for particles.

It travels inside a `Checkpoint` as MessagePack that only coordinators read, so its form may change
with each version of `STATE_VERSION`; a state of another version is left out.
"""

import math

import msgspec

from coordinator.belief.cluster_set import Cluster
from protocol.answers import Hypothesis
from protocol.message import Covariance, PoseTuple
from protocol.steps import Scan
from protocol.work import SearchJob, TrackJob

STATE_VERSION = 1


class SearchState(msgspec.Struct, frozen=True):
    """A search under way."""

    search: int
    first_step: int
    possible: tuple[Hypothesis, ...] = ()
    """What is told of it; empty where there are clusters, which are told instead."""


class FitState(msgspec.Struct, frozen=True):
    """What tracking is used to."""

    usual: float
    recent: float
    lost: bool


class PriorPose(msgspec.Struct, frozen=True):
    """A place that is possible from earlier knowledge, until the first search has ended."""

    step: int
    odom_from_robot: PoseTuple
    map_from_robot: PoseTuple
    covariance: Covariance
    probability: float


class EnsembleState(msgspec.Struct, frozen=True):
    """The belief and the search for new places."""

    clusters: tuple[Cluster, ...]
    """In the order in which they are summed."""
    next_cluster: int
    fit: FitState
    search: SearchState | None
    searches: int
    next_search_step: int
    prior_pose: PriorPose | None = None


class JobState(msgspec.Struct, frozen=True):
    """One job and who has it."""

    job_id: str
    epoch: int
    worker: str | None
    job: SearchJob | TrackJob | None
    """None: a cluster whose particles its worker holds."""


class CheckpointState(msgspec.Struct, frozen=True):
    """Everything that a coordinator would need to carry on."""

    version: int
    map_digest: str
    ensemble: EnsembleState
    jobs: tuple[JobState, ...]
    applied: Scan | None
    """The scan of the last applied step, without its beams."""
    missing: tuple[str, ...]
    """Of the last applied step."""
    age_s: float
    """Of the newest data when this was written; -1: none."""
    steps_applied: int
    steps_lost: int
    reports_missing: int
    set_poses: int
    counters: dict[str, int]
    commands_done: dict[str, str]
    """The last commands' ids to the reason why they were refused."""


def to_bytes(state: CheckpointState) -> bytes:
    """The state as it travels."""
    return msgspec.msgpack.encode(state)


def from_bytes(data: bytes) -> CheckpointState:
    """The state in a checkpoint.

    Raises:
        ValueError: it is none, or of another version.
    """
    try:
        version = msgspec.msgpack.decode(data, type=_Version).version
        if version != STATE_VERSION:
            raise ValueError(f"state of version {version}, expected {STATE_VERSION}")
        state = msgspec.msgpack.decode(data, type=CheckpointState)
    except (msgspec.DecodeError, msgspec.ValidationError, RecursionError) as error:
        raise ValueError(f"not a coordinator's state: {error}") from None
    clusters = {cluster.job_id for cluster in state.ensemble.clusters}
    held = {job.job_id for job in state.jobs if job.job is None}
    if held - clusters or (held and state.applied is None):
        raise ValueError("a job whose particles a worker holds has no cluster")
    if any(math.isnan(cluster.log_probability) for cluster in state.ensemble.clusters):
        raise ValueError("a probability that is none")
    return state


class _Version(msgspec.Struct, frozen=True):
    version: int
