import numpy as np
import pytest

from clustermcl import ClusterMCL, MalformedMessageError
from tests.integration.system.conftest import SMALL
from tests.unit.clustermcl.tags import CROSS, TAGS, beliefs, is_right

TICKS = 400
SEEDS = range(8)


def test_one_step_after_the_first_observation_the_robot_is_found() -> None:
    found: list[bool] = []
    for seed in SEEDS:
        after = [(belief, tick) for belief, tick, seen in beliefs(seed, SMALL, TICKS) if seen]
        if len(after) > 1:  # some robots stay in the arms without a tag
            belief, tick = after[1]
            found.append(belief.state == "localized" and is_right(belief, tick))
        if len(found) == 4:
            break
    assert found == [True] * 4


def test_without_an_observation_the_arms_stay_equally_probable() -> None:
    for seed in range(3):
        reported = [belief.state for belief, *_ in beliefs(seed, SMALL, TICKS // 2, observes=False)]
        assert "localized" not in reported


def test_with_a_tenth_of_false_landmark_names_the_robot_is_rarely_sure_and_wrong() -> None:
    steps = wrong = 0
    for seed in SEEDS[:4]:
        for belief, tick, _ in beliefs(seed, SMALL, TICKS, false=0.1):
            steps += 1
            wrong += belief.state == "localized" and not is_right(belief, tick)
    assert steps > 300
    assert wrong <= 0.005 * steps


def test_an_impossible_observation_is_refused() -> None:
    mcl = ClusterMCL(CROSS.map, landmarks=TAGS, settings=SMALL)
    with pytest.raises(MalformedMessageError, match="not positive definite"):
        mcl.observe((1.0, 0.0), np.zeros((2, 2)), landmark="east")
    with pytest.warns(UserWarning, match="'south' by 'sensor'"):
        mcl.observe((1.0, 0.0), np.eye(2), landmark="south")
    assert mcl.dropped == {"unknown_landmark": 1}
