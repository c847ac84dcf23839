"""Messages as a system sends them, small."""

from typing import Any

import numpy as np
from msgspec.structs import replace

from clustermcl.protocol.answers import Belief, Hypothesis, PoseAnswer, Status
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.health import Health, SourceHealth
from clustermcl.protocol.job_events import Began, JobEvents, NumberedEvent
from clustermcl.protocol.steps import MapMessage, Scan
from clustermcl.protocol.work import Particles, TrackReport


def hypothesis(cluster: int, probability: float) -> Hypothesis:
    return Hypothesis(
        cluster=cluster,
        probability=probability,
        log_probability=float(np.log(probability)),
        pose=(float(cluster), 2.0, 0.5),
        covariance=(0.4, 0.1, 0.0, 0.1, 0.3, 0.0, 0.0, 0.0, 0.2),
        effective_sample_size=100.0,
        age_steps=3,
    )


def belief(step: int, *clusters: int, term: int = 1) -> Belief:
    return Belief(
        sender="coordinator",
        step=step,
        stamp_ns=step,
        odom_from_robot=(0.0, 0.0, 0.0),
        state="ambiguous",
        hypotheses=tuple(hypothesis(cluster, 0.9 / len(clusters)) for cluster in clusters),
        elsewhere_probability=0.1,
        searching=False,
        term=term,
    )


def report(step: int, cluster: int, *, job: str = "", particles: int = 100) -> TrackReport:
    poses = np.tile((float(cluster), 2.0, 0.5), (particles, 1))
    snapshot = Particles(
        step=step,
        odom_from_robot=(0.0, 0.0, 0.0),
        map_from_robot=ArrayBlob.of(poses, "float64"),
        log_weights=ArrayBlob.of(np.zeros(particles), "float64"),
    )
    return TrackReport(
        sender="w",
        job_id=job or f"c{cluster}",
        epoch=1,
        step=step,
        log_weight_sum=0.0,
        particles=particles,
        log_likelihood_per_beam=0.0,
        effective_sample_size=1.0,
        pose=(0.0, 0.0, 0.0),
        covariance=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        snapshot=snapshot if particles else None,
    )


def scan(step: int, ranges: list[float], *, digest: str = "d1") -> Scan:
    return Scan(
        sender="bridge",
        step=step,
        stamp_ns=step,
        odom_from_robot=(0.0, 0.0, 0.0),
        robot_from_laser=(1.0, 0.0, 0.0),
        angle_min_rad=0.0,
        angle_step_rad=np.pi / 2,
        range_max_m=10.0,
        ranges=ArrayBlob.of(np.array(ranges), "float32"),
        map_digest=digest,
    )


def events(*numbers: int, term: int = 1) -> JobEvents:
    numbered = tuple(
        NumberedEvent(number=n, step=n, stamp_ns=n, event=Began(f"c{n}", "restart", 0.1))
        for n in numbers
    )
    return JobEvents(sender="coordinator", events=numbered, term=term)


POSE = PoseAnswer(
    sender="coordinator",
    state="ambiguous",
    freshness="fresh",
    stamp_ns=0,
    age_s=0.1,
    step=0,
    probability=0.5,
    pose=(1.0, 2.0, 0.5),
    covariance=(0.04, 0.0, 0.0, 0.0, 0.09, 0.0, 0.0, 0.0, 0.01),
    workers=2,
    term=1,
    elsewhere_probability=0.1,
)


def pose(step: int, **changed: Any) -> PoseAnswer:
    return replace(POSE, **{"step": step, "stamp_ns": step, **changed})


STATUS = Status(
    sender="coordinator",
    version="1",
    state="ambiguous",
    freshness="fresh",
    age_s=0.1,
    step=5,
    steps_applied=6,
    steps_lost=0,
    reports_missing=0,
    map_digest="d1",
    clusters=2,
    searching=False,
    workers={"w-0": ("c1", "c2"), "w-1": ()},
    counters={"late": 2, "never": 0},
    uptime_s=9.0,
)


def status(*, digest: str = "d1", **changed: Any) -> Status:
    return replace(STATUS, map_digest=digest, **changed)


EYE = SourceHealth(name="eye exit", recent_nat=9.44, outlier_rate=0.7, broken_probability=0.8)


def simulator() -> Health:
    """As the simulator publishes it: there is a robot that can be lifted."""
    return Health(sender="simulator", role="bridge", version="1", uptime_s=1.0, sources=(EYE,))


def map_message(digest: str = "d1") -> MapMessage:
    return MapMessage(
        sender="bridge",
        digest=digest,
        cell_m=0.5,
        map_from_grid=(0.0, 0.0, 0.0),
        rows=2,
        cols=3,
        zlib_cells=b"",
    )
