import pytest

from clustermcl.filter.random_streams import Purpose, generator


def test_the_numbers_of_a_stream_never_change() -> None:
    """Recorded runs depend on them: a change here breaks every stored result."""
    rng = generator(7, purpose=Purpose.SEARCH, entity=3, step=12, part=1)
    assert rng.bit_generator.random_raw(2).tolist() == [14629400463069208583, 730425428241206642]


@pytest.mark.parametrize("name", ["seed", "entity", "step", "part"])
@pytest.mark.parametrize("value", [-1, 2**64])
def test_numbers_that_would_wrap_into_other_streams_are_refused(name: str, value: int) -> None:
    arguments = {"seed": 0, "entity": 0, "step": 0, "part": 0} | {name: value}
    with pytest.raises(ValueError, match=name):
        generator(arguments.pop("seed"), purpose=Purpose.TRACK, **arguments)
