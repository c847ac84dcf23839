import msgpack
import msgspec
import numpy as np
import pytest

from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.message import Message
from clustermcl.protocol.steps import Observation, OdometryReading, PositionField
from tests.unit.coordinator.reports import cloud_at, scan, searched, tracked

READING = OdometryReading(sender="robot", stamp_ns=1, odom_from_robot=(1.0, 2.0, 3.0))


def test_an_observation_on_the_wire_has_these_fields() -> None:
    plain = {
        "schema": "observation/1", "sender": "camera", "stamp_ns": 1, "landmark": "tag 7",
        "mean": [2.0, -0.5], "covariance": [0.25, 0.0, 0.0, 0.25],
    }  # fmt: skip
    defaults = {"outlier_probability": 0.05, "correlation_s": 30.0, "field": None, "floor": ""}
    defaults |= {"floors": {}}
    observation = decode(msgpack.packb(plain), Observation)
    assert msgpack.unpackb(encode(observation)) == plain | defaults
    values = ArrayBlob.of(np.array([[0.0, -1.0]]), "float32")
    region = PositionField(cell_m=5.0, log_likelihoods=values)
    blob = {"dtype": "float32", "shape": [1, 2], "data": b"\0\0\0\0\0\0\x80\xbf"}
    on_the_wire = {"cell_m": 5.0, "log_likelihoods": blob, "map_digest": ""}
    assert msgpack.unpackb(msgspec.msgpack.encode(region)) == on_the_wire


def test_an_unknown_field_of_a_later_release_is_ignored() -> None:
    plain = msgpack.unpackb(encode(READING)) | {"temperature_k": 300.0}
    assert decode(msgpack.packb(plain), OdometryReading) == READING


def test_an_array_comes_back_read_only_and_little_endian() -> None:
    array = ArrayBlob.of(np.arange(6, dtype=">f8").reshape(2, 3), "float64").array()
    np.testing.assert_array_equal(array, np.arange(6.0).reshape(2, 3))
    assert not array.flags.writeable


@pytest.mark.parametrize(
    "message",
    [
        READING,
        scan(3, live=True),
        tracked("c1", 4, 0.1, (1.0, 2.0, 3.0), snapshot=cloud_at((0.0, 0.0, 0.0), 4)),
        searched("s0.0", 2**40, {(1.0, 2.0, 3.0): 0.5}),
    ],
)
def test_any_messagepack_library_can_read_a_message(message: Message) -> None:
    plain = msgspec.to_builtins(message, builtin_types=(bytes,))
    assert msgpack.packb(plain, use_bin_type=True) == encode(message)
