from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from particle_filter.random_streams import Purpose, generator

words = st.integers(0, 2**64 - 1)


@given(seed=words, entity=words, step=words, part=words, purpose=st.sampled_from(Purpose))
def test_the_same_work_draws_the_same_numbers(
    seed: int, entity: int, step: int, part: int, purpose: Purpose
) -> None:
    first = generator(seed, purpose=purpose, entity=entity, step=step, part=part)
    second = generator(seed, purpose=purpose, entity=entity, step=step, part=part)
    np.testing.assert_array_equal(first.random(4), second.random(4))


def test_the_numbers_of_a_stream_never_change() -> None:
    """Recorded runs depend on them: a change here breaks every stored result."""
    rng = generator(7, purpose=Purpose.SEARCH, entity=3, step=12, part=1)
    assert rng.bit_generator.random_raw(2).tolist() == [14629400463069208583, 730425428241206642]


def test_neighbouring_work_draws_unrelated_numbers() -> None:
    drawn = [
        generator(seed, purpose=purpose, entity=entity, step=step, part=part).random(64)
        for seed, purpose, entity, step, part in product(
            range(3), Purpose, range(3), range(3), range(3)
        )
    ]
    assert len({float(value) for stream in drawn for value in stream}) == 64 * len(drawn)
    # Correlations of 64 pairs have a deviation of 1/8; five of them and a bit: false alarms
    # of all ~50,000 pairs together are under 3 %, and the numbers are fixed anyway.
    correlations = np.asarray(np.corrcoef(drawn))[np.triu_indices(len(drawn), 1)]
    assert np.abs(correlations).max() < 0.66
    assert abs(correlations.mean()) < 0.005


def test_streams_of_different_work_lie_apart_in_the_counter() -> None:
    """Only the lowest word counts, so that 2**64 blocks of one stream meet no other."""
    rng = generator(5, purpose=Purpose.TRACK, entity=1, step=2, part=3)
    rng.standard_normal(100_000)
    counter = rng.bit_generator.state["state"]["counter"]
    assert counter[0] < 2**20
    assert list(counter[1:]) == [1, 2, 3]
    assert list(rng.bit_generator.state["state"]["key"]) == [5, int(Purpose.TRACK)]


@pytest.mark.parametrize("name", ["seed", "entity", "step", "part"])
@pytest.mark.parametrize("value", [-1, 2**64])
def test_numbers_that_would_wrap_into_other_streams_are_refused(name: str, value: int) -> None:
    arguments = {"seed": 0, "entity": 0, "step": 0, "part": 0} | {name: value}
    with pytest.raises(ValueError, match=name):
        generator(arguments.pop("seed"), purpose=Purpose.TRACK, **arguments)
