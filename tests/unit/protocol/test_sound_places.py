"""Many places are found sound at once only if each of them is."""

import math

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st
from msgspec.structs import replace

from protocol.arrays import ArrayBlob
from protocol.sound_places import are_sound
from protocol.validity import MAX_STEP, problem_of
from protocol.work import Particles, Place
from tests.unit.coordinator.reports import searched

NUMBERS = st.sampled_from((0.0, -1e-9, 1.0, 1.1, 5e11, -5e11, 1e300, math.nan, math.inf, -math.inf))


def cloud(count: int, *, x_m: float = 1.0, log_weight: float = 0.0) -> Particles:
    poses, logs = np.full((count, 3), x_m), np.full(count, log_weight)
    return Particles(
        step=3,
        odom_from_robot=(0.0, 0.0, 0.0),
        map_from_robot=ArrayBlob.of(poses, "float32"),
        log_weights=ArrayBlob.of(logs, "float32"),
    )


def place(sample: Particles) -> Place:
    identity = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    return Place(share=0.1, mean=(1.0, 2.0, 3.0), covariance=identity, sample=sample)


SOUND = [place(cloud(count)) for count in (1, 5, 2)]


def refused(places: list[Place]) -> bool:
    """Whether the report is refused, each place being looked at."""
    return problem_of(replace(searched("s0.0", 3, {}), places=tuple(places))) is not None


def test_what_workers_send_is_sound() -> None:
    assert are_sound(SOUND, MAX_STEP)
    assert are_sound([], MAX_STEP)
    some_lost = cloud(3)
    weights = ArrayBlob.of(np.array([0.0, -math.inf, -3.0]), "float32")
    assert are_sound([place(replace(some_lost, log_weights=weights))], MAX_STEP)


@pytest.mark.parametrize(
    "sample",
    [
        cloud(2, x_m=math.nan),
        cloud(2, log_weight=-math.inf),
        cloud(2, log_weight=math.inf),
        cloud(2, log_weight=math.nan),
        cloud(0),
        replace(cloud(2), step=-1),
        replace(cloud(2), step=MAX_STEP),
        replace(cloud(2), odom_from_robot=(math.inf, 0.0, 0.0)),
        replace(cloud(2), log_weights=cloud(3).log_weights),
        replace(cloud(2), map_from_robot=cloud(2).log_weights),
        replace(cloud(2), map_from_robot=replace(cloud(2).map_from_robot, shape=(3, 2))),
        replace(cloud(2), map_from_robot=replace(cloud(2).map_from_robot, data=b"")),
        replace(cloud(2), log_weights=replace(cloud(2).log_weights, shape=(-2,))),
    ],
)
def test_one_bad_sample_among_good_ones_is_found(sample: Particles) -> None:
    places = [SOUND[0], place(sample), SOUND[1]]
    assert not are_sound(places, MAX_STEP)
    assert refused(places)


@hypothesis.given(
    share=NUMBERS, mean=st.tuples(NUMBERS, NUMBERS, NUMBERS), covariance=st.tuples(*[NUMBERS] * 9)
)
def test_together_no_number_passes_that_alone_would_not(
    share: float, mean: tuple[float, ...], covariance: tuple[float, ...]
) -> None:
    odd = replace(SOUND[0], share=share, mean=mean, covariance=covariance)
    assert not (are_sound([*SOUND, odd], MAX_STEP) and refused_alone(odd))


def refused_alone(odd: Place) -> bool:
    """By the look at each place: a double sample is none of those that are checked together."""
    double = ArrayBlob.of(np.ones((2, 3)), "float64")
    other = replace(cloud(2), map_from_robot=double)
    assert not are_sound([place(other)], MAX_STEP)
    assert not refused([place(other)])
    return refused([odd, place(other)])
