import pytest

from clustermcl.filter.random_streams import Purpose, generator


def test_the_numbers_of_a_stream_never_change() -> None:
    """Recorded runs depend on them: a change here breaks every stored result."""
    rng = generator(7, purpose=Purpose.SEARCH, entity=3, step=12, part=1)
    assert rng.bit_generator.random_raw(2).tolist() == [14629400463069208583, 730425428241206642]


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
