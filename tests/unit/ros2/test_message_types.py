from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.ros2 import message_types as types
from clustermcl.ros2.message_types import decode, encode, new, request_of, response_of, type_hash
from clustermcl.ros2.messages_out import particle_cloud

MESSAGES = [
    value
    for name, value in vars(types).items()
    if name.isupper() and isinstance(value, str) and "/msg/" in value
]
SERVICES = [
    value
    for name, value in vars(types).items()
    if name.isupper() and isinstance(value, str) and "/srv/" in value
]
HALVES = [half(service) for service in SERVICES for half in (request_of, response_of)]


@pytest.mark.parametrize("ros_type", [*MESSAGES, *HALVES])
def test_every_decoded_message_equals_the_encoded_one(ros_type: str) -> None:
    data = encode(new(ros_type), ros_type)
    assert encode(decode(data, ros_type), ros_type) == data


@pytest.mark.parametrize(
    ("ros_type", "hashed"),
    [
        (types.LASER_SCAN, "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828"),
        (types.OCCUPANCY_GRID, "8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7"),
        (types.POSE_STAMPED, "26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"),
        (types.TF_MESSAGE, "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"),
        (types.NAV_SAT_FIX, "62223ab3fe210a15976021da7afddc9e200dc9ec75231c1b6a557fc598a65404"),
        (types.PARTICLE_CLOUD, "193d8cb88ca2b98cd81ece15342744f054bb398ebfa8f6369914432303f42b11"),
        (types.BOND_STATUS, "87eaccffa254ffffadc0b61600452e8251740f06c25659a2dbda4927fdb1f70a"),
    ],
)
def test_hashes_are_those_of_ros(ros_type: str, hashed: str) -> None:
    assert type_hash(ros_type, humble=False) == f"RIHS01_{hashed}"


def test_every_service_has_a_hash_of_its_own() -> None:
    hashes = {type_hash(service, humble=False) for service in SERVICES}
    assert len(hashes) == len(SERVICES) == 13


@pytest.mark.parametrize("ros_type", [types.LASER_SCAN, types.TF_MESSAGE, types.OCCUPANCY_GRID])
@given(data=st.binary(max_size=200))
def test_random_bytes_raise_nothing_but_a_malformed_message_error(
    ros_type: str, data: bytes
) -> None:
    for candidate in (data, types.CDR_HEADER + data):
        with suppress(MalformedMessageError):
            decode(candidate, ros_type)


@pytest.mark.parametrize("data", [b"", b"abc", types.CDR_HEADER, types.CDR_HEADER + b"\xff" * 40])
def test_invalid_bytes_are_malformed(data: bytes) -> None:
    with pytest.raises(MalformedMessageError) as raised:
        decode(data, types.LASER_SCAN)
    assert raised.value.cause == "malformed LaserScan: not CDR"


def test_an_unknown_field_is_refused() -> None:
    with pytest.raises(TypeError):
        new(types.STRING, words="x")


@given(
    count=st.integers(0, 5), frame=st.text(max_size=9), stamp_ns=st.integers(0, 2**31 * 10**9 - 1)
)
def test_the_fast_cloud_has_the_bytes_of_the_general_encoder(
    count: int, frame: str, stamp_ns: int
) -> None:
    rng = np.random.default_rng(3)
    poses, weights = rng.normal(size=(count, 3)), rng.random(count)
    data = particle_cloud(poses, weights, stamp_ns, frame)
    cloud = decode(data, types.PARTICLE_CLOUD)
    assert encode(cloud, types.PARTICLE_CLOUD) == data
    assert cloud.header.frame_id == frame
    assert cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec == stamp_ns
    for particle, pose, weight in zip(cloud.particles, poses, weights, strict=True):
        turn = particle.pose.orientation
        assert (particle.pose.position.x, particle.pose.position.y) == (pose[0], pose[1])
        assert particle.weight == weight
        heading = 2.0 * np.arctan2(turn.z, turn.w)
        assert np.isclose(np.remainder(heading - pose[2] + np.pi, 2 * np.pi), np.pi)
