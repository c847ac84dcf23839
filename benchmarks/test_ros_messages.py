"""What a robot of ROS waits for, and what it draws: `pytest benchmarks/test_ros_messages.py`."""

import numpy as np
from pytest_benchmark.fixture import BenchmarkFixture

from clustermcl.protocol.answers import Belief, Hypothesis
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.work import Particles
from clustermcl.ros2.messages_out import particle_cloud
from clustermcl.ros2.particles import CLOUD, ClusterParticles

PLACES = 4
COVARIANCE = (0.1, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.01)


def belief() -> Belief:
    return Belief(
        sender="coordinator", step=3, stamp_ns=1, odom_from_robot=(1.0, 0.5, 0.2),
        state="ambiguous", searching=False,
        hypotheses=tuple(
            Hypothesis(
                cluster=number, probability=1.0 / PLACES, log_probability=0.0,
                pose=(1.0, 2.0, 0.5), covariance=COVARIANCE, effective_sample_size=900.0,
                age_steps=5,
            )
            for number in range(PLACES)
        ),
    )  # fmt: skip


def test_a_particle_cloud_of_all_places(benchmark: BenchmarkFixture) -> None:
    """From the workers' particle reports to the bytes on the wire: under 1 ms."""
    rng, clouds = np.random.default_rng(1), ClusterParticles()
    for number in range(PLACES):
        message = Particles(
            step=1,
            odom_from_robot=(0.0, 0.0, 0.0),
            map_from_robot=ArrayBlob.of(rng.normal(size=(2_000, 3)), "float64"),
            log_weights=ArrayBlob.of(rng.normal(size=2_000), "float64"),
        )
        clouds.on_particles(number, message)
    believed = belief()

    def cloud() -> bytes:
        drawn = clouds.cloud(believed)
        assert drawn is not None
        return particle_cloud(*drawn, believed.stamp_ns, "map")

    assert len(benchmark(cloud)) > CLOUD * 64
