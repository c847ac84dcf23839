"""The whole stack, started and ended at random moments: nothing hangs, nothing is left."""

import random
import sys
from pathlib import Path

import pytest

from tests.integration.load.programs.start_stop import random_moment, run_cycle

if sys.platform != "linux":
    pytest.skip("only Linux ends children with their parent", allow_module_level=True)


def assert_all_end_cleanly(seeds: range, cache: Path) -> None:
    for seed in seeds:
        moment = random_moment(random.Random(seed))
        ended = run_cycle(moment, cache)
        assert not ended.problems, f"{moment}: " + "\n".join(ended.problems)


@pytest.mark.parametrize("seed", [0, 1, 2, 4, 7])  # both signals, once and twice, early and late
def test_a_stack_ended_at_any_moment_ends_cleanly_within_three_seconds(
    seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    cache = tmp_path_factory.getbasetemp() / "likelihood-fields"
    assert_all_end_cleanly(range(seed, seed + 1), cache)


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_two_hundred_cycles_of_start_and_stop_end_cleanly(tmp_path: Path) -> None:
    assert_all_end_cleanly(range(1000, 1200), tmp_path)
