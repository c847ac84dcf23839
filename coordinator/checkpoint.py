"""The state of a coordinator as it is handed on: everything that decides, but for particles.

Each part of the coordinator says in its own module what of it is handed on; here these are put
together. The whole travels inside a `Checkpoint` as MessagePack that only coordinators read, so
its form may change with each `STATE_VERSION`; a state of another version is refused.
"""

import math
from collections.abc import Collection, Iterable, Sequence

import msgspec

from coordinator.belief.cluster_set import Cluster
from coordinator.belief.ensemble import ELSEWHERE, EnsembleState
from coordinator.belief.prior_pose import PriorPose
from coordinator.belief.search_course import DecoyState
from coordinator.belief.search_pool import SearchState
from coordinator.commands import CommandsState
from coordinator.jobs import JobState
from coordinator.step_collector import StepCollectorState
from particle_filter.evidence_model import UsualFit
from particle_filter.off_map import MapQuality
from protocol.codec import refusal_of
from protocol.errors import MalformedMessageError
from protocol.message import MAX_ID_CHARACTERS, MAX_STEP
from protocol.names import is_name
from protocol.reading_checks import pose_problem
from protocol.steps import Scan
from protocol.validity import assignment_problem, drawable_problem, first_problem
from protocol.work import Assignment, Checkpoint, ElsewhereJob, SearchJob, TrackJob

MAX_ITEMS = 2_000
"""Clusters, jobs, places or causes: fifty times those of the largest robot known."""
MAX_COUNT = 2**52
"""Of what a coordinator counts by itself: half of what a message may say, so that it can go on."""
MAX_CHARACTERS = 500
"""Of one text, such as the cause of a counter."""
MAX_AGE_S = 1e9
SUM_TOLERANCE = 1e-6
"""Of probabilities: those of ten thousand clusters still sum to one within 1e-12."""


def ensemble_problem(state: EnsembleState, applied: Scan | None) -> str | None:
    """Return why no coordinator can have had this belief after the step `applied`, if so."""
    if state.clusters and applied is None:
        return "no cluster can be tracked before the first step"
    if problem := items_problem(state.clusters) or first_problem(
        "a decoy among the clusters" if cluster.mirrored else _cluster_problem(cluster, applied)
        for cluster in state.clusters
    ):
        return problem
    numbers = [cluster.cluster for cluster in state.clusters]
    if len(set(numbers)) < len(numbers) or max(numbers, default=-1) >= state.next_cluster:
        return "clusters whose numbers are taken, or were never given"
    nowhere = (state.log_elsewhere, state.log_off_map)
    if problem := (
        first_problem(map(_elsewhere_problem, nowhere))
        or _quality_problem(state.quality)
        or _fit_problem(state.fit)
    ):
        return problem
    probabilities = [*map(math.exp, nowhere), *(c.probability for c in state.clusters)]
    if abs(math.fsum(probabilities) - 1) > SUM_TOLERANCE:
        return "probabilities that do not sum to one"
    search, prior = state.search, state.prior_pose
    return (
        _count_problem("next cluster", state.next_cluster)
        or _count_problem("searches", state.searches)
        or (_search_problem(search, state.searches, applied) if search else None)
        or _decoy_problem(state.decoy, applied)
        or (_prior_problem(prior) if prior else None)
        or state.seen.problem
    )


def _decoy_problem(decoy: DecoyState, applied: Scan | None) -> str | None:
    search, begun = decoy.search.search, decoy.search.searches
    if not all(place.mirrored for place in decoy.places):
        return "a decoy that follows the robot itself"
    return (
        items_problem(decoy.places)
        or _count_problem("searches", begun)
        or (_search_problem(search, begun, applied) if search else None)
        or first_problem(_cluster_problem(place, applied) for place in decoy.places)
    )


def _cluster_problem(cluster: Cluster, applied: Scan | None) -> str | None:
    newest = applied.step if applied else -1
    if not -1 <= cluster.born_step <= newest:
        return f"a cluster of step {cluster.born_step}"
    if cluster.log_probability > SUM_TOLERANCE:
        return f"a cluster's probability is above one: its logarithm is {cluster.log_probability}"
    return (
        number_problem("cluster", cluster.cluster)
        or finite_problem("logarithm of a cluster's probability", cluster.log_probability)
        or _size_problem("effective sample size", cluster.effective_sample_size)
        or drawable_problem(cluster.mean, cluster.covariance)
    )


def jobs_problem(
    jobs: Sequence[JobState], ensemble: EnsembleState, applied: Scan | None
) -> str | None:
    """Why these cannot be the jobs of this belief: each cluster has one, and the search some."""
    ids = [job.job_id for job in jobs]
    tracked = (*ensemble.clusters, *ensemble.decoy.places)
    clusters = {cluster.job_id for cluster in tracked}
    if len(set(ids)) < len(ids):
        return "a job that is there twice"
    if clusters - set(ids):
        return "a cluster that has no job"
    searches = (ensemble.search, ensemble.decoy.search.search)
    return first_problem(_job_problem(job, clusters, searches, applied) for job in jobs)


def collector_problem(state: StepCollectorState) -> str | None:
    """Why no steps can be over like this."""
    scan = state.applied
    return _count_problem("steps lost", state.steps_lost) or (_scan_problem(scan) if scan else None)


def commands_problem(state: CommandsState) -> str | None:
    """Why this cannot have been commanded."""
    texts = [*state.problems, *state.problems.values()]
    waiting = state.waiting
    return (
        _count_problem("poses given", state.set_poses)
        or texts_problem(texts)
        or (refusal_of(waiting.command) if waiting else None)
        or (pose_problem(waiting.odom_from_robot or (0.0, 0.0, 0.0)) if waiting else None)
    )


def age_problem(age_s: float) -> str | None:
    """Why no data is so old."""
    possible = age_s == -1.0 or 0.0 <= age_s <= MAX_AGE_S  # NaN is neither
    return None if possible else f"an age of {age_s} s"


def texts_problem(texts: Collection[str]) -> str | None:
    """Why these are no names or causes."""
    if len(texts) > 2 * MAX_ITEMS or max(map(len, texts), default=0) > MAX_CHARACTERS:
        return f"{len(texts)} texts, or one of more than {MAX_CHARACTERS} characters"
    return None


def counts_problem(counts: Iterable[int]) -> str | None:
    """Why these are no counts."""
    return first_problem(_count_problem("count", count) for count in counts)


def _count_problem(name: str, count: int) -> str | None:
    """Return why a coordinator cannot have this count, or could not continue from it."""
    full = f"{name} {count} leaves no room to count on" if count >= MAX_COUNT else None
    return number_problem(name, count) or full


def items_problem(items: Collection[object]) -> str | None:
    """Why there are too many of something."""
    return f"{len(items)} of one kind" if len(items) > MAX_ITEMS else None


def _search_problem(state: SearchState, searches: int, applied: Scan | None) -> str | None:
    if state.search >= searches:
        return f"search {state.search} has never begun"
    if applied is not None and state.first_step > applied.step + 1:
        return f"a search that begins at step {state.first_step}"
    return (
        number_problem("search", state.search)
        or number_problem("first step", state.first_step, least=-1)
        or items_problem(state.evidence.gathered)
        or first_problem(map(_gathered_problem, state.evidence.gathered.items()))
        or (None if 0.0 <= state.evidence.explained <= 1.0 else "a search that explains too much")
        or (None if 0.0 <= state.progress <= 1.0 else "a search beyond its end")
        or _elsewhere_problem(state.evidence.log_elsewhere)
        or _elsewhere_problem(state.evidence.log_off_map)
    )


def _elsewhere_problem(log_probability: float) -> str | None:
    if log_probability <= SUM_TOLERANCE:  # NaN is not
        return None
    return f"elsewhere with a probability whose logarithm is {log_probability}"


def _quality_problem(quality: MapQuality) -> str | None:
    possible = all(
        0.0 < share < 1.0 for share in (quality.crude, quality.resembling, quality.alike)
    )
    return None if possible and 0.0 <= quality.short <= 1.0 else f"a map of {quality}"


def _fit_problem(fit: UsualFit) -> str | None:
    possible = 0.0 < fit.variance < math.inf and 0.0 <= fit.shortfall < math.inf
    possible &= fit.mean is None or math.isfinite(fit.mean)
    return None if possible else f"scans whose usual fit is {fit}"


def _gathered_problem(gathered: tuple[int, float]) -> str | None:
    step, log_likelihood = gathered
    return number_problem("step", step) or finite_problem("log-likelihood", log_likelihood)


def _prior_problem(prior: PriorPose) -> str | None:
    if not 0.0 <= prior.probability <= 1.0:
        return f"a prior pose of probability {prior.probability}"
    return (
        number_problem("step", prior.step, least=-1)
        or pose_problem(prior.odom_from_robot)
        or drawable_problem(prior.map_from_robot, prior.covariance)
    )


def _job_problem(
    state: JobState,
    clusters: set[str],
    searches: tuple[SearchState | None, SearchState | None],
    applied: Scan | None,
) -> str | None:
    if len(state.job_id) > MAX_ID_CHARACTERS or not (state.worker is None or is_name(state.worker)):
        return "a job or a worker with no name"
    job = state.job
    match job:
        case None:
            fits = state.job_id in clusters
        case TrackJob():
            kind = "d" if job.mirrored else "c"
            fits = state.job_id in clusters and state.job_id == f"{kind}{job.cluster}"
        case ElsewhereJob():
            due = applied is None or job.first_step <= applied.step + 1
            fits = state.job_id == ELSEWHERE and due
        case SearchJob():
            search, kind = searches[job.mirrored], "m" if job.mirrored else "s"
            begun = search and (search.search, search.first_step) == (job.search, job.first_step)
            fits = bool(begun) and state.job_id == f"{kind}{job.search}.{job.shard}"
    if not fits:
        return "a job that has no cluster, no search and no step"
    if job is None:
        return number_problem("epoch", state.epoch)
    return assignment_problem(Assignment(job_id=state.job_id, epoch=state.epoch, job=job))


def _scan_problem(scan: Scan) -> str | None:
    """Why the beams cannot be a scan's, even one whose beams were left out."""
    try:
        blobs = (scan.ranges, *(laser.ranges for laser in scan.others))
        shapes = [ranges.array().shape for ranges in blobs]
    except MalformedMessageError as error:
        return error.problem
    return None if all(len(shape) == 1 for shape in shapes) else f"ranges of {shapes}"


def _size_problem(name: str, value: float) -> str | None:
    return f"a negative {name}" if value < 0.0 else finite_problem(name, value)


def number_problem(name: str, number: int, *, least: int = 0) -> str | None:
    return None if least <= number < MAX_STEP else f"{name} {number} is out of range"


def finite_problem(name: str, value: float) -> str | None:
    return None if math.isfinite(value) else f"{name} is {value}"


STATE_VERSION = 6


class ImpossibleStateError(ValueError):
    """No coordinator can have been in this state."""


class CheckpointState(msgspec.Struct, frozen=True):
    """Everything that a coordinator would need to carry on."""

    version: int
    map_digest: str
    ensemble: EnsembleState
    jobs: tuple[JobState, ...]
    collector: StepCollectorState
    commands: CommandsState
    missing: tuple[str, ...]
    """Jobs that did not report the last applied step in time."""
    age_s: float
    """Of the applied scan when this was written, by a live robot's stamps, else of the newest data;
    -1: none."""
    age_known: bool
    """Whether its coordinator has received data itself; otherwise the age is unknown."""
    steps_applied: int
    reports_missing: int
    counters: dict[str, int]


def to_bytes(state: CheckpointState) -> bytes:
    """The state as it travels."""
    return msgspec.msgpack.encode(state)


def from_bytes(data: bytes) -> CheckpointState:
    """The state as it was before it travelled.

    Raises:
        ImpossibleStateError: numbers in it cannot be, or contradict each other.
        ValueError: it cannot be read, or is of another version.
    """
    try:
        version = _VERSIONS.decode(data).version
        if version != STATE_VERSION:
            raise ValueError(f"state of version {version}, expected {STATE_VERSION}")
        state = _STATES.decode(data)
    except (msgspec.DecodeError, msgspec.ValidationError, RecursionError) as error:
        raise ValueError(f"not a coordinator's state: {error}") from None
    if problem := _problem(state):
        raise ImpossibleStateError(problem)
    return state


def state_in(checkpoint: Checkpoint) -> CheckpointState:
    """The state in a checkpoint, which is of the step that the checkpoint says.

    Raises:
        ValueError: as `from_bytes`.
    """
    state = from_bytes(checkpoint.state)
    applied = state.collector.applied
    if checkpoint.step != (applied.step if applied else -1):
        raise ImpossibleStateError(f"a checkpoint of step {checkpoint.step} with another's state")
    return state


def _problem(state: CheckpointState) -> str | None:
    """Why the state is impossible; None where it can have been."""
    counts = (state.steps_applied, state.reports_missing, *state.counters.values())
    return (
        items_problem(state.jobs)
        or collector_problem(state.collector)
        or ensemble_problem(state.ensemble, state.collector.applied)
        or jobs_problem(state.jobs, state.ensemble, state.collector.applied)
        or commands_problem(state.commands)
        or age_problem(state.age_s)
        or counts_problem(counts)
        or texts_problem((state.map_digest, *state.missing, *state.counters))
    )


def arrival(checkpoint: Checkpoint, heard_ns: int) -> tuple[int, int] | None:
    """Return the stamp of the applied scan, and when it arrived, by the clock of `heard_ns` [ns].

    None if no live robot's scan was applied, or the state cannot be read.
    """
    try:
        state = _AGES.decode(checkpoint.state)
    except (msgspec.DecodeError, msgspec.ValidationError, RecursionError):
        return None
    applied = state.collector.applied
    is_told = state.version == STATE_VERSION and state.age_known and not age_problem(state.age_s)
    if not is_told or applied is None or not applied.live:
        return None
    return applied.stamp_ns, heard_ns - int(state.age_s * 1e9)


class _Version(msgspec.Struct, frozen=True):
    version: int


class _Applied(msgspec.Struct, frozen=True):
    stamp_ns: int
    live: bool


class _Collector(msgspec.Struct, frozen=True):
    applied: _Applied | None


class _Age(_Version, frozen=True):
    collector: _Collector
    age_s: float
    age_known: bool


# Made once, before there are threads: msgspec learns a type when it is first decoded, and crashes
# where another thread, as the flight recorder's, decodes it meanwhile.
_VERSIONS = msgspec.msgpack.Decoder(_Version)
_AGES = msgspec.msgpack.Decoder(_Age)
_STATES = msgspec.msgpack.Decoder(CheckpointState)
