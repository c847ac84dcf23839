"""Whether what is in a checkpoint can have been a coordinator's state.

Workers keep checkpoints unread, and whoever can publish one can have one kept. So each number is
checked as those of all messages are, and that the parts fit each other: a coordinator that ends
over another's state would do so again each time it is started.
"""

import math
from collections.abc import Collection, Iterable, Sequence

from coordinator.belief.cluster_set import Cluster
from coordinator.belief.ensemble import ELSEWHERE, EnsembleState
from coordinator.belief.prior_pose import PriorPose
from coordinator.belief.search_pool import SearchState
from coordinator.commands import CommandsState
from coordinator.membership.jobs import JobState
from coordinator.step_collector import StepCollectorState
from particle_filter.evidence_model import UsualFit
from particle_filter.off_map import MapQuality
from protocol.codec import refusal_of
from protocol.message import MAX_ID_CHARACTERS, MAX_SCAN_STEP, MAX_STEP
from protocol.names import is_name
from protocol.reading_checks import odometry_problem, pose_problem
from protocol.steps import OdometryReading, Scan
from protocol.validity import assignment_problem, drawable_problem, first_problem
from protocol.work import Assignment, ElsewhereJob, SearchJob, TrackJob

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
    """Why nobody can have believed this after the step `applied`; None where one can."""
    if state.clusters and applied is None:
        return "no cluster can be tracked before the first step"
    if problem := items_problem(state.clusters) or first_problem(
        _cluster_problem(cluster, applied) for cluster in state.clusters
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
        or (_prior_problem(prior) if prior else None)
        or state.seen.problem
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
    clusters = {cluster.job_id for cluster in ensemble.clusters}
    if len(set(ids)) < len(ids):
        return "a job that is there twice"
    if clusters - set(ids):
        return "a cluster that has no job"
    return first_problem(_job_problem(job, clusters, ensemble.search, applied) for job in jobs)


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
    """Why a coordinator cannot have counted so far, or could not count on from there."""
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
        or first_problem(map(_gathered_problem, state.evidence.gathered))
        or (None if 0.0 <= state.evidence.explained <= 1.0 else "a search that explains too much")
        or (None if 0.0 <= state.progress <= 1.0 else "a search beyond its end")
        or _elsewhere_problem(state.evidence.log_elsewhere)
    )


def _elsewhere_problem(log_probability: float) -> str | None:
    if log_probability <= SUM_TOLERANCE:  # NaN is not
        return None
    return f"elsewhere with a probability whose logarithm is {log_probability}"


def _quality_problem(quality: MapQuality) -> str | None:
    possible = all(0.0 < share < 1.0 for share in (quality.crude, quality.resembling))
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
    state: JobState, clusters: set[str], search: SearchState | None, applied: Scan | None
) -> str | None:
    if len(state.job_id) > MAX_ID_CHARACTERS or not (state.worker is None or is_name(state.worker)):
        return "a job or a worker with no name"
    job = state.job
    match job:
        case None:
            fits = state.job_id in clusters
        case TrackJob():
            fits = state.job_id in clusters and state.job_id == f"c{job.cluster}"
        case ElsewhereJob():
            due = applied is None or job.first_step <= applied.step + 1
            fits = state.job_id == ELSEWHERE and due
        case SearchJob():
            begun = search and (search.search, search.first_step) == (job.search, job.first_step)
            fits = bool(begun) and state.job_id == f"s{job.search}.{job.shard}"
    if not fits:
        return "a job that has no cluster, no search and no step"
    if job is None:
        return number_problem("epoch", state.epoch)
    return assignment_problem(Assignment(job_id=state.job_id, epoch=state.epoch, job=job))


def _scan_problem(scan: Scan) -> str | None:
    """As of any scan, but that its beams were left out."""
    pose = OdometryReading(
        sender=scan.sender, stamp_ns=scan.stamp_ns, odom_from_robot=scan.odom_from_robot
    )
    return (
        scan_step_problem(scan.step)
        or odometry_problem(pose)
        or pose_problem(scan.robot_from_laser)
    )


def _size_problem(name: str, value: float) -> str | None:
    return f"a negative {name}" if value < 0.0 else finite_problem(name, value)


def number_problem(name: str, number: int, *, least: int = 0) -> str | None:
    return None if least <= number < MAX_STEP else f"{name} {number} is out of range"


def scan_step_problem(step: int) -> str | None:
    return None if 0 <= step < MAX_SCAN_STEP else f"step {step} is out of range"


def finite_problem(name: str, value: float) -> str | None:
    return None if math.isfinite(value) else f"{name} is {value}"
