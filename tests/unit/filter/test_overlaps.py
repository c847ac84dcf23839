import math

import numpy as np
import pytest

from clustermcl.belief import log_probabilities as belief
from clustermcl.belief.overlaps import is_near, merge_overlapping
from tests.unit.filter.naive import angle_between


def test_hundreds_of_clusters_merge_as_one_by_one() -> None:
    rng = np.random.default_rng(0)
    many = np.column_stack((rng.uniform(0.0, 9.0, (700, 2)), rng.uniform(-4.0, 4.0, 700)))
    absorber = list[int]()
    for k, mean in enumerate(many):
        near = (
            i
            for i, other in enumerate(many[:k])
            if math.dist(mean[:2], other[:2]) <= 0.5 and angle_between(mean[2], other[2]) <= 0.35
        )
        absorber.append(next((i for i in near if absorber[i] == i), k))
    assert merge_overlapping(many, 0.5, 0.35).tolist() == absorber
    assert 100 < len(set(absorber)) < 600


def test_a_pose_is_near_if_another_is_near_in_position_and_heading() -> None:
    others = [[0.0, 0.0, 3.1], [5.0, 0.0, 0.0]]
    poses = [[0.3, 0.0, -3.1], [0.3, 0.0, 0.0], [5.0, 0.5, 0.35], [5.0, 0.6, 0.0]]
    assert is_near(poses, others, 0.5, 0.35).tolist() == [True, False, True, False]
    assert is_near(poses, [], 0.5, 0.35).tolist() == [False] * 4
    assert is_near([], others, 0.5, 0.35).tolist() == []


@pytest.mark.parametrize("value", [np.nan, -np.inf], ids=["no report", "impossible everywhere"])
def test_what_says_the_same_of_all_places_changes_nothing(value: float) -> None:
    prior = belief.normalised_logs(np.array([0.0, -1.0]))
    np.testing.assert_array_equal(belief.updated(prior, np.full(2, value)), prior)


def test_a_belief_without_mass_is_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        belief.normalised_logs(np.full(3, -np.inf))
