import math

import numpy as np

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
