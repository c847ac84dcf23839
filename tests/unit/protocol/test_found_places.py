import math

import hypothesis
import msgspec
import numpy as np
import pytest
from hypothesis import strategies as st
from msgspec.structs import replace

from clustermcl.protocol.arrays import ArrayBlob, WireType
from clustermcl.protocol.codec import decode, encode, refusal_of
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.found_places import FoundPlaces
from clustermcl.protocol.work import Place, SearchReport
from tests.unit.coordinator.reports import cloud_at, searched

MEAN = (1.0, 2.0, 3.0)
SOUND = FoundPlaces.of(
    (0.5, 0.0, 0.1),
    [0.6, 0.3, 0.1],
    [MEAN] * 3,
    [np.eye(3)] * 3,
    [np.full((count, 3), float(count)) for count in (1, 5, 2)],
)
NUMBERS = st.sampled_from((0.0, -1e-9, 1.0, 1.1, 5e11, -5e11, 1e300, math.nan, math.inf, -math.inf))


def report(found: FoundPlaces) -> SearchReport:
    return replace(searched("s0.0", 3, {}), places=found)


def changed(column: str, index: int | tuple[int, int], value: float) -> FoundPlaces:
    """The sound places with one number of a column changed."""
    blob: ArrayBlob = getattr(SOUND, column)
    array = blob.array().copy()
    array[index] = value
    return replace(SOUND, **{column: ArrayBlob.of(array, blob.dtype)})


def column(values: object, dtype: WireType = "float64") -> ArrayBlob:
    return ArrayBlob.of(np.array(values), dtype)


def test_packed_places_are_unpacked_unchanged() -> None:
    came = decode(encode(report(SOUND)), SearchReport).places
    assert (came, len(came)) == (SOUND, 3)
    assert came.covariance.array().tolist() == [np.eye(3).ravel().tolist()] * 3
    assert came.count.array().tolist() == [1, 5, 2]
    assert came.particles.array()[:, 0].tolist() == [1.0, *[5.0] * 5, *[2.0] * 2]


@pytest.mark.parametrize(
    "found",
    [
        changed("count", 1, 0),
        replace(SOUND, count=column([-1, 7, 2], "int32")),
        replace(SOUND, count=column([2**31 - 1, 2**31 - 1, 10], "int32")),
        replace(SOUND, count=column([1, 7], "int32")),
        changed("particles", (7, 2), math.nan),
        replace(SOUND, share=column([[0.6], [0.3], [0.1]])),
        replace(SOUND, share=replace(SOUND.share, shape=())),
        replace(SOUND, share=column([0.6, 0.3, 0.1], "float32")),
        replace(SOUND, mean=column([MEAN] * 2)),
        replace(SOUND, mean=column([MEAN[:2]] * 3)),
        replace(SOUND, covariance=column([MEAN] * 3)),
        replace(SOUND, particles=replace(SOUND.particles, shape=(3, 8))),
        replace(SOUND, mean=replace(SOUND.mean, shape=(-3, -3))),
        replace(SOUND, odom_from_robot=(math.inf, 0.0, 0.0)),
    ],
)
def test_one_bad_number_among_good_ones_is_found(found: FoundPlaces) -> None:
    nothing = FoundPlaces.of((0.0, 0.0, 0.0), [], [], [], [])
    assert refusal_of(report(SOUND)) is refusal_of(report(nothing)) is None
    with pytest.raises(MalformedMessageError, match="not a valid SearchReport"):
        decode(encode(report(found)), SearchReport)


@hypothesis.given(
    share=NUMBERS, mean=st.tuples(NUMBERS, NUMBERS, NUMBERS), covariance=st.tuples(*[NUMBERS] * 9)
)
def test_columns_accept_only_numbers_that_a_single_place_accepts(
    share: float, mean: tuple[float, float, float], covariance: tuple[float, ...]
) -> None:
    sample = cloud_at(MEAN, 3)
    alone = Place(share=share, pose=mean, covariance=covariance, sample=sample)  # type: ignore[arg-type] # nine numbers
    one = FoundPlaces.of((0.0, 0.0, 0.0), [share], [mean], [covariance], [np.ones((2, 3))])
    try:
        is_accepted = msgspec.msgpack.decode(msgspec.msgpack.encode(alone), type=Place) == alone
    except msgspec.ValidationError:
        is_accepted = False
    assert (refusal_of(report(one)) is None) == is_accepted
