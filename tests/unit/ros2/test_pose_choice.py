import numpy as np
import pytest

from clustermcl.protocol.answers import Belief
from clustermcl.ros2.pose_choice import PoseChoice
from clustermcl.runtime.settings import Publish
from tests.unit.ros2.ports import COVARIANCE, belief

A, B, C = (0.0, 0.0, 0.0), (8.0, 0.0, 3.1), (0.5, 0.2, 0.1)
SURE_OF_1 = belief(1, (1, 0.95, A), (2, 0.05, B), state="localized")
RATHER_2 = belief(2, (2, 0.6, B), (1, 0.4, A))
SURE_OF_2 = belief(3, (2, 0.93, B), (1, 0.07, A), state="localized")
NOWHERE = belief(4, state="searching")


def reported(publish: Publish, *beliefs: Belief) -> list[int | None]:
    choice = PoseChoice(publish)
    chosen = [choice.choose(one, A) for one in beliefs]
    return [one.cluster if one else None for one in chosen]


@pytest.mark.parametrize(
    ("publish", "clusters"),
    [
        ("held", [None, 1, 1, 2, 2, None, None]),
        ("best", [2, 1, 2, 2, 2, None, 2]),
        ("localized", [None, 1, None, 2, None, None, None]),
    ],
)
def test_each_publish_rule_chooses_its_place(publish: Publish, clusters: list[int | None]) -> None:
    beliefs = (RATHER_2, SURE_OF_1, RATHER_2, SURE_OF_2, RATHER_2, NOWHERE, RATHER_2)
    assert reported(publish, *beliefs) == clusters


def test_the_held_place_follows_its_cluster_into_a_merge() -> None:
    merged = belief(2, (2, 0.6, B), (3, 0.4, C))
    assert reported("held", SURE_OF_1, merged) == [1, 3]


def test_without_a_place_near_the_ended_one_the_most_probable_is_held() -> None:
    ended = belief(2, (2, 0.6, B), (3, 0.4, B))
    assert reported("held", SURE_OF_1, ended) == [1, 2]


def test_the_covariance_includes_the_other_places_until_the_robot_is_localized() -> None:
    choice = PoseChoice("held")
    sure = choice.choose(SURE_OF_1, None)
    held = choice.choose(RATHER_2, A)
    assert sure
    assert held
    assert (sure.covariance, sure.probability) == (COVARIANCE, 0.95)
    assert (held.pose, held.probability) == (A, 0.4)
    off = np.array(B)  # the other place, as seen from the held one
    wide = np.reshape(COVARIANCE, (3, 3)) + 0.6 * np.outer(off, off)
    np.testing.assert_allclose(np.reshape(held.covariance, (3, 3)), wide)


@pytest.mark.parametrize("shares", [(0.3, 0.2), (0.0, 0.0)])
def test_the_covariance_is_that_of_a_robot_at_one_of_the_places(
    shares: tuple[float, float],
) -> None:
    wide = belief(1, (1, shares[0], A), (2, shares[1], A))
    found = PoseChoice("best").choose(wide, None)
    assert found
    np.testing.assert_allclose(found.covariance, COVARIANCE)
