import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.ros2 import message_types as types
from clustermcl.ros2.messages_out import particle_cloud
from tests.ros_messages import decode, typestore


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
    assert bytes(typestore().serialize_cdr(cloud, types.PARTICLE_CLOUD)) == data
    assert cloud.header.frame_id == frame
    assert cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec == stamp_ns
    for particle, pose, weight in zip(cloud.particles, poses, weights, strict=True):
        turn = particle.pose.orientation
        assert (particle.pose.position.x, particle.pose.position.y) == (pose[0], pose[1])
        assert particle.weight == weight
        heading = 2.0 * np.arctan2(turn.z, turn.w)
        assert np.isclose(np.remainder(heading - pose[2] + np.pi, 2 * np.pi), np.pi)
