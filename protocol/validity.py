"""Check messages for implausible numbers, after their types have been checked.

A NaN in one report would make every probability NaN. Laser readings are not checked here: the
bridge checks them and counts each kind of defect.
"""

import math
from collections.abc import Iterable
from functools import singledispatch

import numpy as np

from protocol.answers import Drive, Kidnap, Relocalize, SetPose, Update
from protocol.errors import MalformedMessageError
from protocol.found_places import found_places_problem
from protocol.health import Health
from protocol.job_events import Ended, JobEvents, NumberedEvent
from protocol.message import MAX_POSE_M, Circle, Covariance, PoseTuple
from protocol.pose_arrays import covariance_matrix
from protocol.reading_checks import laser_problem, odometry_problem, pose_problem, stamp_problem
from protocol.steps import OdometryReading, Scan, ScanHistory, TruePose
from protocol.work import (
    Assignment,
    Checkpoint,
    ElsewhereJob,
    ElsewhereReport,
    OrderAnswer,
    Particles,
    Place,
    SearchJob,
    SearchReport,
    TakeOver,
    TrackJob,
    TrackReport,
    WorkerState,
    WorkOrder,
)

MAX_STEP = 2**53
"""Limit for steps, epochs and order numbers: 28 million years at 10 Hz."""
MAX_SCAN_STEP = 2**50
"""Limit for the steps of scans, so that numbers derived from them stay below `MAX_STEP`."""
MAX_ID_CHARACTERS = 128
MAX_WORDS = 500
"""Entries in a health message; processes have about twenty."""
MAX_SIGMA_M = 1e4
MAX_PARTICLES = 1_000_000
"""Particles of one cluster."""
FLATNESS = 1e-6
"""Tolerance for rounding in singular covariances, relative to the largest entry."""


@singledispatch
def problem_of(message: object) -> str | None:  # noqa: ARG001 - what most messages need
    """Why a message is implausible, or None."""
    return None


@problem_of.register
def _(message: OdometryReading) -> str | None:
    return odometry_problem(message)


@problem_of.register
def _(message: Scan) -> str | None:
    return scan_step_problem(message.step) or laser_problem(message)


@problem_of.register
def _(message: ScanHistory) -> str | None:
    return first_problem(problem_of(scan) for scan in message.scans)


@problem_of.register
def _(message: TruePose) -> str | None:
    return pose_problem(message.map_from_robot)


@problem_of.register
def _(message: WorkOrder) -> str | None:
    return (
        number_problem("order", message.order)
        or number_problem("term", message.term)
        or number_problem("snapshot_every_steps", message.snapshot_every_steps)
        or first_problem(assignment_problem(given) for given in message.begin)
    )


@problem_of.register
def _(message: OrderAnswer) -> str | None:
    return (
        number_problem("order", message.order)
        or number_problem("term", message.term)
        or first_problem(number_problem("epoch", epoch) for _, epoch, _ in message.jobs)
    )


@problem_of.register
def _(message: TakeOver) -> str | None:
    return number_problem("term", message.term) or number_problem("since", message.since, least=-1)


@problem_of.register
def _(message: WorkerState) -> str | None:
    # Of what it holds, a coordinator leaves out what cannot be, and believes the rest.
    return number_problem("term", message.term) or first_problem(
        number_problem("term", term) for term in (message.founded, *message.terms)
    )


@problem_of.register
def _(message: Checkpoint) -> str | None:
    return (
        number_problem("term", message.term)
        or number_problem("serial", message.serial)
        or number_problem("step", message.step, least=-1)
    )


@problem_of.register
def _(message: TrackReport) -> str | None:
    snapshots = () if message.snapshot is None else (message.snapshot,)
    return (
        _report_problem(message)
        or finite_problem("log_weight_sum", message.log_weight_sum)
        or finite_problem("effective_sample_size", message.effective_sample_size)
        or first_problem(number_problem("beams", count) for count in message.beam_classes)
        or gaussian_problem(message.mean, message.covariance)
        or first_problem(_particles_problem(snapshot) for snapshot in snapshots)
        or first_problem(_place_problem(place) for place in message.parts)
    )


@problem_of.register
def _(message: SearchReport) -> str | None:
    return (
        _report_problem(message)
        or finite_problem("log_evidence", message.log_evidence)
        or finite_problem("left_out_gap", message.left_out_gap)
        or pose_problem(message.places.odom_from_robot)
        or found_places_problem(message.places)
    )


@problem_of.register
def _(message: ElsewhereReport) -> str | None:
    return (
        number_problem("step", message.step)
        or number_problem("epoch", message.epoch)
        or finite_problem("log_likelihood", message.log_likelihood)
    )


@problem_of.register
def _(message: Health) -> str | None:
    counts = (message.done, message.rates_per_s, message.ages_s, message.dropped)
    words = [word for mapping in counts for word in mapping]
    if len(words) > MAX_WORDS or max(map(len, (message.sender, *words))) > MAX_ID_CHARACTERS:
        return f"{len(words)} words, or one of more than {MAX_ID_CHARACTERS} characters"
    values = [message.uptime_s, *(value for mapping in counts for value in mapping.values())]
    return None if all(map(math.isfinite, values)) else "a number that is not finite"


@problem_of.register
def _(message: JobEvents) -> str | None:
    return number_problem("term", message.term) or first_problem(
        map(_event_problem, message.events)
    )


@problem_of.register
def _(message: SetPose) -> str | None:
    sigmas = (message.position_sigma_m, message.heading_sigma_rad)
    if not all(0.0 < sigma <= MAX_SIGMA_M for sigma in sigmas):  # NaN is not
        return f"sigmas {sigmas} are not positive numbers"
    return (
        _id_problem(message.command_id)
        or pose_problem(message.map_from_robot)
        or (message.covariance and drawable_problem(message.map_from_robot, message.covariance))
        or stamp_problem(message.stamp_ns or 0)
    )


@problem_of.register
def _(message: Relocalize) -> str | None:
    return (
        _id_problem(message.command_id)
        or _circle_problem(message.near)
        or ("the region's name is too long" if len(message.region) > MAX_ID_CHARACTERS else None)
    )


@problem_of.register
def _(message: Update) -> str | None:
    return _id_problem(message.command_id)


@problem_of.register
def _(message: Drive) -> str | None:
    return finite_problem("speed_m_s", message.speed_m_s) or finite_problem(
        "turn_rate_rad_s", message.turn_rate_rad_s
    )


@problem_of.register
def _(message: Kidnap) -> str | None:
    problem = pose_problem(message.map_from_robot) if message.map_from_robot else None
    return _id_problem(message.command_id) or problem


def first_problem(problems: Iterable[str | None]) -> str | None:
    return next((problem for problem in problems if problem), None)


def _circle_problem(circle: Circle | None) -> str | None:
    if circle is None or (all(map(math.isfinite, circle)) and circle[2] > 0.0):
        return None
    return f"{circle} is not a circle"


def _report_problem(report: TrackReport | SearchReport) -> str | None:
    if math.isinf(report.log_likelihood_per_beam):  # NaN: the scan had no beam to score
        return "log_likelihood_per_beam is infinite"
    if report.particles < 1:
        return f"{report.particles} particles"
    return number_problem("step", report.step) or number_problem("epoch", report.epoch)


def number_problem(name: str, number: int, *, least: int = 0) -> str | None:
    """Why a number of a step, epoch, order or term is invalid, or None."""
    return None if least <= number < MAX_STEP else f"{name} {number} is out of range"


def scan_step_problem(step: int) -> str | None:
    return None if 0 <= step < MAX_SCAN_STEP else f"step {step} is out of range"


def finite_problem(name: str, value: float) -> str | None:
    return None if math.isfinite(value) else f"{name} is {value}"


def _id_problem(command_id: str) -> str | None:
    if 0 < len(command_id) <= MAX_ID_CHARACTERS:
        return None
    return f"a command_id of {len(command_id)} characters, not 1 to {MAX_ID_CHARACTERS}"


def _event_problem(numbered: NumberedEvent) -> str | None:
    event = numbered.event
    jobs = (event.job_id, *(event.by if isinstance(event, Ended) else ()))
    if max(map(len, jobs)) > MAX_ID_CHARACTERS:
        return f"a job's id of more than {MAX_ID_CHARACTERS} characters"
    if not 0.0 <= event.probability <= 1.000001:  # rounded sums
        return f"a probability of {event.probability}"
    return number_problem("number", numbered.number)


def assignment_problem(given: Assignment) -> str | None:
    """Why an assignment is invalid, or None."""
    problem = number_problem("epoch", given.epoch) or number_problem("term", given.term)
    match given.job:
        case TrackJob(start=start, particles=count):
            if count is not None and not 0 < count <= MAX_PARTICLES:
                return f"a cluster of {count} particles"
            return problem or _particles_problem(start)
        case ElsewhereJob(first_step=first) | SearchJob(first_step=first):
            return problem or number_problem("first step", first, least=-1)


def gaussian_problem(mean: PoseTuple, covariance: Covariance) -> str | None:
    """Why a pose with a covariance is invalid, or None; checks only what is cheap to check."""
    variances = (covariance[0], covariance[4], covariance[8])
    if not math.isfinite(sum(covariance)) or min(variances) < 0.0:
        return "a covariance with a negative variance, or an entry that is not finite"
    return pose_problem(mean)


def drawable_problem(mean: PoseTuple, covariance: Covariance) -> str | None:
    """Why particles cannot be drawn from this Gaussian, or None."""
    if problem := gaussian_problem(mean, covariance):
        return problem
    matrix = covariance_matrix(covariance)
    largest = float(np.max(np.abs(matrix)))
    if largest > MAX_POSE_M**2:
        return f"a variance of {largest}"
    lopsided = float(np.max(np.abs(matrix - matrix.T)))
    least = float(np.linalg.eigvalsh(matrix)[0])
    if lopsided > FLATNESS * largest or least < -FLATNESS * largest:
        return "a covariance that is not symmetric and positive semi-definite"
    return None


def _place_problem(place: Place) -> str | None:
    if not 0.0 <= place.share <= 1.000001:  # shares are rounded sums
        return f"a share of {place.share}"
    return gaussian_problem(place.mean, place.covariance) or _particles_problem(place.sample)


def _particles_problem(particles: Particles) -> str | None:
    """Why a particle set is invalid, or None."""
    try:
        poses, log_weights = particles.map_from_robot.array(), particles.log_weights.array()
    except MalformedMessageError as error:
        return error.problem
    if poses.ndim != 2 or poses.shape[1] != 3 or log_weights.shape != poses.shape[:1]:
        return f"no particle set: poses {poses.shape}, weights {log_weights.shape}"
    if not np.all(np.isfinite(poses)):
        return "a particle whose pose is not finite"
    if not (len(log_weights) and math.isfinite(float(np.max(log_weights)))):
        return "particles without weight"  # a NaN makes the maximum NaN
    return number_problem("step", particles.step) or pose_problem(particles.odom_from_robot)
