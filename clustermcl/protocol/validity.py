"""Check what the types of a message's fields cannot express: arrays and covariances.

A NaN in one report would make every probability NaN. Laser readings are not checked here: the
bridge checks them and counts each kind of defect.
"""

import math
from collections.abc import Iterator

import numpy as np

from clustermcl.protocol import work
from clustermcl.protocol.advice import AdviceQuestion
from clustermcl.protocol.answers import SetPose
from clustermcl.protocol.causes import key_of
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.found_places import found_places_problem
from clustermcl.protocol.message import Covariance, PoseTuple
from clustermcl.protocol.reading_checks import (
    covariance_problem,
    observation_problem,
    pose_problem,
    scan_problem,
)
from clustermcl.protocol.steps import Observation, Scan, ScanHistory

FLATNESS = 1e-6
"""Tolerance for rounding in singular covariances, relative to the largest entry."""


def problem_of(message: object) -> str | None:
    """Return why a message, or an assignment of one, is implausible, or None."""
    try:
        return next(filter(None, _problems(message)), None)
    except MalformedMessageError as error:  # of an array
        return error.problem


def _problems(message: object) -> Iterator[str | None]:
    match message:
        case Changes():
            yield message.problem
        case Scan():
            yield scan_problem(message)
        case Observation():
            yield observation_problem(message)
        case (
            ScanHistory(scans=parts) | work.WorkOrder(begin=parts) | work.ReportBatch(reports=parts)
        ):
            yield from map(problem_of, parts)
        case work.Assignment(job=work.TrackJob(start=start)):
            yield _particles_problem(start)
        case work.TrackReport(snapshot=work.Particles() as snapshot):
            yield _particles_problem(snapshot)
        case work.SearchReport(places=places):
            yield found_places_problem(places)
        case work.ElsewhereReport(seen=seen, places=places):
            if seen is not None:
                seen.checked(None, 2)
            yield None if places is None else found_places_problem(places)
        case SetPose(pose=pose, covariance=tuple() as covariance):
            yield gaussian_problem(pose, covariance)
            yield covariance_problem(
                covariance, -math.inf, -FLATNESS
            )  # particles are drawn from it
        case AdviceQuestion(hypotheses=places):
            if not all(0.0 <= place.probability <= 1.0 for place in places):
                yield "a place whose probability is not from 0 to 1"
            yield from (gaussian_problem(place.pose, place.covariance) for place in places)


def gaussian_problem(mean: PoseTuple, covariance: Covariance) -> str | None:
    """Return why a pose or its covariance is invalid, or None; makes only the cheap checks."""
    variances = (covariance[0], covariance[4], covariance[8])
    if not math.isfinite(sum(covariance)) or min(variances) < 0.0:
        return "a covariance with a negative variance, or an entry that is not finite"
    return key_of(problem) if (problem := pose_problem(mean)) else None


def _particles_problem(particles: work.Particles) -> str | None:
    """Return why a particle set is invalid, or None; or raise a `MalformedMessageError`."""
    log_weights = particles.log_weights.array()  # -inf is one
    if log_weights.ndim != 1:
        return f"weights {log_weights.shape}"
    particles.map_from_robot.checked(len(log_weights), 3)
    if not (len(log_weights) and math.isfinite(float(np.max(log_weights)))):
        return "particles without weight"  # a NaN makes the maximum NaN
    return None
