"""Encoding and decoding of what goes over the wire at every step."""

from collections.abc import Callable

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from clustermcl.protocol.answers import Belief, Hypothesis, PoseAnswer
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.message import Message
from clustermcl.protocol.steps import LaserReading, OdometryReading, Scan
from clustermcl.protocol.work import Assignment, Particles, TrackJob, TrackReport, WorkOrder

POSE = (1.0, 2.0, 0.5)
COVARIANCE = (0.1, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.01)
RANGES = ArrayBlob.of(np.linspace(0.5, 20.0, 181), "float32")
PARTICLES = Particles(
    step=7,
    odom_from_robot=POSE,
    map_from_robot=ArrayBlob.of(np.zeros((2_000, 3)), "float64"),
    log_weights=ArrayBlob.of(np.zeros(2_000), "float64"),
)


def report(snapshot: Particles | None) -> TrackReport:
    return TrackReport(
        sender="worker-1", job_id="c1", epoch=1, step=7, log_weight_sum=1.0, particles=2_000,
        effective_sample_size=900.0, pose=POSE,
        covariance=COVARIANCE, snapshot=snapshot,
    )  # fmt: skip


def order() -> WorkOrder:
    job = TrackJob(cluster=1, start=PARTICLES, exact=True)
    return WorkOrder(
        sender="coordinator", order=1, map_digest="0" * 64, filter_settings={},
        snapshot_every_steps=10, keep=(), begin=(Assignment(job_id="c1", epoch=1, job=job),),
    )  # fmt: skip


HYPOTHESES = tuple(
    Hypothesis(
        cluster=number, probability=0.1, log_probability=-2.3, pose=POSE, covariance=COVARIANCE,
        effective_sample_size=900.0, age_steps=5,
    )
    for number in range(10)
)  # fmt: skip
MESSAGES: dict[str, Message] = {
    "odometry": OdometryReading(sender="robot", stamp_ns=1, odom_from_robot=POSE),
    "laser, 181 beams": LaserReading(
        sender="robot", stamp_ns=1, ranges=RANGES, angle_min_rad=-1.5, angle_step_rad=0.01,
        range_max_m=30.0, robot_from_laser=POSE,
    ),
    "scan, 181 beams": Scan(
        sender="bridge", step=7, stamp_ns=1, odom_from_robot=POSE, robot_from_laser=POSE,
        angle_min_rad=-1.5, angle_step_rad=0.01, range_max_m=30.0, ranges=RANGES,
        map_digest="0" * 64,
    ),
    "report": report(None),
    "report with 2,000 particles": report(PARTICLES),
    "order with 2,000 particles": order(),
    "belief of 10 clusters": Belief(
        sender="coordinator", step=7, stamp_ns=1, odom_from_robot=POSE, state="ambiguous",
        hypotheses=HYPOTHESES, searching=False,
    ),
    "pose": PoseAnswer(
        sender="coordinator", state="localized", freshness="fresh", stamp_ns=1, age_s=0.1, step=7,
        probability=0.9, pose=POSE, covariance=COVARIANCE, workers=12,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MESSAGES)
def test_encoding(benchmark: BenchmarkFixture, name: str) -> None:
    data = benchmark(encode, MESSAGES[name])
    benchmark.extra_info["bytes"] = len(data)


@pytest.mark.parametrize("name", MESSAGES)
def test_decoding(benchmark: BenchmarkFixture, name: str) -> None:
    message = MESSAGES[name]
    decoding: Callable[..., object] = benchmark
    assert decoding(decode, encode(message), type(message)) == message
