from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from clustermcl.coordinator.events import (
    OdometryArrived,
    ReportArrived,
    ScanArrived,
    TimePassed,
    WorkerChanged,
)
from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.protocol import work
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.codec import decode, encode, refusal_of
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import (
    Landmark,
    LaserReading,
    Observation,
    OdometryReading,
    PositionField,
    Reading,
    Scan,
    Seen,
)
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.step_maker import StepMaker
from clustermcl.worker.job_table import JobTable
from tests.fuzz.effort import cases
from tests.unit.coordinator.reports import cloud_at, elsewhere, scan, searched, tracked
from tests.unit.coordinator.test_coordinator import SECOND, Story
from tests.unit.worker.test_job_table import SETTINGS, cloud, order, track
from tests.unit.worker.test_job_table import model as model  # noqa: PLC0414 - a fixture

ANY_NUMBER = st.floats(-30.0, 30.0) | st.floats()
ANY_POSE: st.SearchStrategy[PoseTuple] = st.tuples(ANY_NUMBER, ANY_NUMBER, ANY_NUMBER)
NEAR_POSE: st.SearchStrategy[PoseTuple] = st.tuples(*[st.floats(-3.0, 3.0)] * 3)
STAMPS = st.integers(0, 20 * SECOND) | st.integers(-(2**63), 2**64)


@st.composite
def blobs(draw: st.DrawFn) -> ArrayBlob:
    """Ranges, mostly; also arrays that are none."""
    if draw(st.integers(0, 9)) == 0:
        shape = tuple(draw(st.lists(st.integers(-2, 9), max_size=3)))
        return ArrayBlob(dtype="float32", shape=shape, data=draw(st.binary(max_size=16)))
    ranges = draw(st.lists(st.floats(0.1, 20.0) | st.floats(width=32), max_size=12))
    with np.errstate(over="ignore"):
        return ArrayBlob.of(np.array(ranges), draw(st.sampled_from(["float32", "float64"])))


LASERS = st.builds(
    LaserReading, sender=st.just("robot"), stamp_ns=STAMPS, ranges=blobs(),
    angle_min_rad=ANY_NUMBER, angle_step_rad=st.floats(-0.5, 0.5) | ANY_NUMBER,
    range_max_m=ANY_NUMBER, robot_from_laser=NEAR_POSE | ANY_POSE,
    odom_from_robot=st.none() | NEAR_POSE | ANY_POSE,
)  # fmt: skip
ODOMETRY = st.builds(
    OdometryReading, sender=st.just("robot"), stamp_ns=STAMPS,
    odom_from_robot=NEAR_POSE | ANY_POSE,
)  # fmt: skip

VARIANCES = st.floats(1e-8, 1e16) | st.floats(0.01, 1.0)


@st.composite
def observations(draw: st.DrawFn) -> Observation:
    landmark, stamp_ns = draw(st.sampled_from(["", "tag", "none"])), draw(st.integers(0, 10**10))
    size = 2 if landmark else draw(st.integers(2, 3))
    sigmas = np.diag(np.sqrt(draw(st.lists(VARIANCES, min_size=size, max_size=size))))
    bonds = np.eye(size) + np.triu(draw(st.floats(-1.0, 1.0)) * np.ones((size, size)), 1)
    covariance = sigmas @ bonds @ bonds.T @ sigmas
    seen = Observation(
        sender="eye", stamp_ns=stamp_ns, landmark=landmark, mean=draw(ANY_POSE)[:size],
        covariance=tuple(covariance.ravel().tolist()),
    )  # fmt: skip
    if size == 2 and not landmark and draw(st.booleans()):
        sides = draw(st.integers(1, 64)), draw(st.integers(1, 64))
        levels = draw(
            st.lists(
                st.floats(allow_nan=False, allow_infinity=False, width=32), min_size=1, max_size=6
            )
        )
        field = PositionField(
            cell_m=draw(st.floats(0.01, 1e8) | st.floats(0.5, 5.0)),
            log_likelihoods=ArrayBlob.of(np.resize(levels, sides), "float32"),
        )
        seen = replace(seen, field=field)
    usual = replace(seen, mean=(1.0,) * size)
    usual = replace(usual, covariance=tuple(np.eye(size).ravel().tolist()))
    return usual if refusal_of(seen) else seen


@st.composite
def seen_in_step(draw: st.DrawFn) -> Seen:
    one = draw(observations())
    return Seen(
        landmark=one.landmark, mean=one.mean, covariance=one.covariance,
        outlier_probability=draw(st.floats(1e-6, 0.999)), share=draw(st.floats(0.0, 1.0)),
        field=one.field,
    )  # fmt: skip


LANDMARKS = st.lists(
    st.builds(
        Landmark, name=st.sampled_from(["tag", "door"]), x=st.floats(-1e8, 1e8) | st.floats(-3, 3),
        y=st.floats(-3, 3), sigma=st.floats(1e-150, 1e8) | st.floats(0.01, 1.0),
    ), max_size=3,
)  # fmt: skip


@cases(0.06)
@given(st.lists(LASERS | ODOMETRY | observations(), max_size=12))
def test_the_bridge_makes_valid_steps_of_any_readings(
    readings: list[Reading | Observation],
) -> None:
    tag = Landmark(name="tag", x=1.0, y=2.0, sigma=0.1)
    maker = StepMaker(BridgeSettings(), "map", "bridge", landmarks=(tag,))
    made = []
    for reading in readings:
        if isinstance(reading, Observation):
            maker.observe(reading)
        else:
            made.append(maker.on_reading(reading))
    made += [maker.finish() for _ in range(len(readings) + 1)]
    steps = [step for step in made if step is not None]
    assert [step.step for step in steps] == list(range(len(steps)))
    for step in steps:
        assert decode(encode(step), Scan) == step
    if maker.odometry is not None:
        stamp_ns, pose = maker.odometry
        odometry = OdometryReading(sender="b", stamp_ns=stamp_ns, odom_from_robot=pose)
        assert decode(encode(odometry), OdometryReading) == odometry


# --- the worker -----------------------------------------------------------------------------------


@st.composite
def scans(draw: st.DrawFn) -> Scan:
    """Valid scans, as mad as validity allows."""
    reading = draw(LASERS)
    step = Scan(
        sender="bridge", step=draw(st.integers(0, 30)), stamp_ns=reading.stamp_ns,
        odom_from_robot=reading.odom_from_robot or (0.0, 0.0, 0.0),
        robot_from_laser=reading.robot_from_laser, angle_min_rad=reading.angle_min_rad,
        angle_step_rad=reading.angle_step_rad, range_max_m=reading.range_max_m,
        ranges=reading.ranges, map_digest="map",
        observations=tuple(draw(st.lists(seen_in_step(), max_size=3))),
        landmarks=tuple(draw(LANDMARKS)),
    )  # fmt: skip
    usual = replace(scan(step.step), angle_step_rad=0.5)
    seeing = replace(usual, observations=step.observations, landmarks=step.landmarks)
    return next(one for one in (step, seeing, usual) if not refusal_of(one))


@cases(0.02)
@given(st.lists(scans(), max_size=6))
def test_a_worker_makes_valid_reports_of_any_scans(
    model: SensorModel, given_scans: list[Scan]
) -> None:
    table = JobTable("worker")
    search = work.SearchJob(search=0, shard=0, first_step=1)
    begun = track("c0", cloud()), work.Assignment(job_id="s0.0", epoch=2, job=search)
    elsewhere = work.Assignment(job_id="e0", epoch=3, job=work.ElsewhereJob(first_step=1))
    table.follow(order(*begun, elsewhere, snapshots=2), model, SETTINGS)
    for one in given_scans:
        for report in table.on_scan(one):
            back = decode(encode(report), type(report))
            assert refusal_of(back) is None


# --- the coordinator ------------------------------------------------------------------------------

JOBS = st.sampled_from(["c0", "c1", "c2", "s0.0", "s1.0", "e0", "m0.0", "d0", "c9", ""])
STEPS = st.integers(0, 12) | st.integers(0, 2**53 - 1)
LOGS = st.floats(-50.0, 50.0) | st.floats(allow_nan=False, allow_infinity=False)


BELIEF = {
    "kidnapping_probability": 0.01,
    "piece_evidence": 0.7,
    "off_map_probability": 0.05,
    "least_probability": 1e-4,
}


@st.composite
def reports(draw: st.DrawFn) -> work.Report:
    """Valid reports of existing and unknown jobs; the epoch is set when one is delivered."""
    poses = NEAR_POSE | ANY_POSE.filter(lambda pose: all(abs(x) < 1e8 for x in pose))
    job, step, pose = draw(JOBS), draw(STEPS), draw(poses)
    if job.startswith(("s", "m")):
        shares = draw(st.dictionaries(poses, st.floats(0.0, 1.0), max_size=4))
        return searched(
            job, step, shares, log_evidence=draw(LOGS), left_out_gap=draw(st.floats(0.0, 20.0))
        )
    if job == "e0":
        return elsewhere(step, draw(LOGS))
    report = tracked(job, step, 1.0, pose, snapshot=draw(st.none() | st.just(cloud_at(pose, step))))
    return replace(
        report, log_weight_sum=draw(LOGS),
        effective_sample_size=draw(st.floats(0.0, 1e9)), particles=draw(st.integers(1, 10**6)),
    )  # fmt: skip


def current(event: Any, story: Story) -> Any:
    """Return an event; a report is of the job's worker and epoch."""
    if not isinstance(event, ReportArrived):
        return event
    job = event.report.job_id
    report = replace(event.report, epoch=story.epochs.get(job, 0))
    return ReportArrived(story.places.get(job, "a"), report)


EVENTS = st.one_of(
    scans().map(ScanArrived),
    st.builds(ReportArrived, st.just("a"), reports()),
    ODOMETRY.filter(lambda odometry: refusal_of(odometry) is None).map(OdometryArrived),
    st.builds(WorkerChanged, st.sampled_from(["a", "b"]), st.sampled_from(["joined", "left"])),
)


@cases(0.08)
@given(st.lists(st.tuples(st.floats(0.0, 3.0), EVENTS), max_size=20), st.booleans())
def test_the_coordinators_probabilities_sum_to_one_after_any_events(
    events: list[tuple[float, Any]], begun: bool
) -> None:
    story = Story("a", "b", **BELIEF)
    if begun:
        story.bootstrapped()
    now_ns = SECOND
    for wait_s, event in events:
        now_ns += int(wait_s * SECOND)
        story.follow(story.coordinator.handle(current(event, story), now_ns))
        story.follow(story.coordinator.handle(TimePassed(), now_ns))
        encode(story.coordinator.pose(now_ns))
        encode(story.coordinator.status(now_ns, {}))
    for belief in story.beliefs:
        probabilities = [place.probability for place in belief.hypotheses]
        assert sum(probabilities) + belief.elsewhere_probability == pytest.approx(1.0)
