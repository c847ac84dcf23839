import msgpack
import numpy as np
import pytest

from protocol import keys
from protocol.arrays import ArrayBlob
from protocol.codec import decode, encode
from protocol.errors import MalformedMessageError
from protocol.message import Message
from protocol.steps import LaserReading, OdometryReading
from tests.soak.malformed import malformed, wrong_readings

SEEN = {
    keys.LASER_READING: encode(
        LaserReading(
            sender="robot",
            stamp_ns=10**18,
            ranges=ArrayBlob.of(np.ones(5), "float32"),
            angle_min_rad=0.0,
            angle_step_rad=0.1,
            range_max_m=9.0,
            robot_from_laser=(0.0, 0.0, 0.0),
        )
    ),
    keys.ODOMETRY_READING: encode(
        OdometryReading(sender="robot", stamp_ns=10**18, odom_from_robot=(1.0, 2.0, 3.0))
    ),
    keys.SCAN: msgpack.packb({"schema": "scan/1", "sender": "bridge", "step": 3}),
}


@pytest.mark.parametrize(
    ("key", "kind"),
    [(keys.LASER_READING, LaserReading), (keys.ODOMETRY_READING, OdometryReading)],
)
def test_rubbish_is_no_message_whatever_is_chosen(key: str, kind: type[Message]) -> None:
    for seed in range(15):
        payloads = [p for k, p in malformed(np.random.default_rng(seed), SEEN) if k == key]
        assert len(payloads) == 9
        for payload in payloads:
            with pytest.raises(MalformedMessageError):
                decode(payload, kind)


def test_wrong_readings_need_examples_and_repeat_the_last_step() -> None:
    assert wrong_readings({}) == []
    assert (keys.SCAN, SEEN[keys.SCAN]) in wrong_readings(SEEN)
