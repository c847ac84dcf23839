import math

import numpy as np
import pytest
from msgspec.structs import replace

from clustermcl.commands.record_landmarks import MAX_OBSERVATIONS, MIN_OBSERVATIONS, LandmarkSurvey
from clustermcl.protocol.steps import MAX_LANDMARKS, Observation, OdometryReading
from tests.unit.view.messages import belief

TAG = np.array([3.0, 4.0])
S = 1_000_000_000


def seen(at_ns: int, mean: tuple[float, ...], name: str = "tag") -> Observation:
    flat = (0.01, 0.0, 0.0, 0.01)
    return Observation(sender="eye", stamp_ns=at_ns, landmark=name, mean=mean, covariance=flat)


def odometry(at_ns: int, x: float) -> OdometryReading:
    return OdometryReading(sender="robot", stamp_ns=at_ns, odom_from_robot=(x, 0.0, 0.0))


def drive(survey: LandmarkSurvey, steps: int, *, state: str = "localized", noise_m: float) -> None:
    """A robot at (1, 2, 0.5) of the map drives 0.2 m of odometry after each belief and looks."""
    rng, cos, sin = np.random.default_rng(3), math.cos(0.5), math.sin(0.5)
    for step in range(steps):
        at_ns = step * S
        place = replace(belief(step, 1), state=state, stamp_ns=at_ns)
        survey.on_odometry(odometry(at_ns, 0.0))
        survey.on_belief(place)
        off = TAG - (1.0 + 0.2 * cos, 2.0 + 0.2 * sin)
        ahead, left = cos * off[0] + sin * off[1], cos * off[1] - sin * off[0]
        x, y = np.array([ahead, left]) + rng.normal(0.0, noise_m, 2)
        survey.on_observation(seen(at_ns + S // 2, (float(x), float(y))))
        survey.on_odometry(odometry(at_ns + S // 2, 0.2))


def test_observations_of_a_localized_robot_are_averaged() -> None:
    survey = LandmarkSurvey(set())
    drive(survey, 50, noise_m=0.1)
    (entry,) = survey.entries()
    assert entry["id"] == "tag"
    assert math.dist((entry["x"], entry["y"]), TAG) < 0.06  # 4 standard errors of 0.1 m / sqrt(50)
    covariance = np.reshape(entry["covariance"], (2, 2))
    assert entry["count"] == 50
    assert covariance[0, 1] == covariance[1, 0]
    assert (np.linalg.eigvalsh(covariance) > 0.02**2 - 1e-6).all()
    assert (np.linalg.eigvalsh(covariance) < 0.3**2).all()


def test_sights_with_a_wrong_name_do_not_count() -> None:
    survey = LandmarkSurvey(set())
    drive(survey, 20, noise_m=0.1)
    sights = survey._seen["tag"]
    sights += [(np.array([9.0, 9.0]), 0.01 * np.eye(2))] * 6
    (entry,) = survey.entries()
    assert math.dist((entry["x"], entry["y"]), TAG) < 0.1
    sights += sights[-1:] * 6
    assert not list(survey.entries())


@pytest.mark.parametrize("state", ["ambiguous", "searching", "lost"])
def test_observations_of_a_robot_that_is_not_localized_do_not_count(state: str) -> None:
    survey = LandmarkSurvey(set())
    drive(survey, 20, state=state, noise_m=0.0)
    assert not list(survey.entries())


def test_landmarks_with_few_or_scattered_observations_are_left_out() -> None:
    few, scattered = LandmarkSurvey(set()), LandmarkSurvey(set())
    drive(few, MIN_OBSERVATIONS - 1, noise_m=0.0)
    drive(scattered, 20, noise_m=3.0)
    assert not list(few.entries())
    assert not list(scattered.entries())


def test_known_names_impossible_and_too_many_observations_are_dropped() -> None:
    survey = LandmarkSurvey({"exit"})
    survey.on_belief(replace(belief(0, 1), state="localized"))
    for step in range(2 * MAX_OBSERVATIONS):
        for mean, name in (((1.0, 0.0), "exit"), ((1e300, 0.0), "far"), ((1.0, 0.0, 0.0), "three")):
            survey.on_observation(seen(step, mean, name))
        survey.on_observation(seen(step, (1.0, 0.0), f"tag {step}"))
        survey.on_odometry(odometry(step, 0.0))
    survey.on_belief(replace(belief(1, 1), state="localized"))
    for number in range(2 * MAX_LANDMARKS):
        survey.on_observation(seen(S, (1.0, 0.0), f"more {number}"))
        survey.on_odometry(odometry(S, 0.0))
    assert len(survey._seen) == MAX_LANDMARKS - 1
    assert not {"exit", "far", "three"} & set(survey._seen)
