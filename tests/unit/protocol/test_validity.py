import math

import msgspec
import numpy as np
import pytest

from clustermcl.protocol import work
from clustermcl.protocol.answers import Kidnap, Relocalize, SetPose
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.codec import MAX_ITEMS, decode, encode
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.message import LARGEST_BYTES, MAX_SCAN_STEP, SMALL_BYTES, Message
from clustermcl.protocol.reading_checks import scan_problem
from clustermcl.protocol.steps import Landmark, OdometryReading, Scan, ScanHistory, Seen, TruePose
from tests.unit.coordinator.reports import (
    cloud_at,
    elsewhere,
    found_places,
    scan,
    searched,
    tracked,
    work_order,
)

ORIGIN = (0.0, 0.0, 0.0)
CLOUD = cloud_at(ORIGIN, 3)
TRACKED = tracked("c0", 3, 0.5, ORIGIN)
SEARCHED = searched("s0.0", 3, {ORIGIN: 1.0})
ELSEWHERE = elsewhere(3, -4.0)
ODOMETRY = OdometryReading(sender="r", stamp_ns=0, odom_from_robot=ORIGIN)
SEARCH = work.SearchJob(search=0, shard=0, first_step=0)
SET_POSE = SetPose(sender="a", command_id="1", pose=ORIGIN)


def changed(message: Message, **fields: object) -> Message:
    return msgspec.structs.replace(message, **fields)


def cloud(poses: np.ndarray, log_weights: np.ndarray) -> work.Particles:
    return msgspec.structs.replace(
        CLOUD,
        map_from_robot=ArrayBlob.of(poses, "float64"),
        log_weights=ArrayBlob.of(log_weights, "float64"),
    )


def order(start: work.Particles) -> work.WorkOrder:
    return begins(work.TrackJob(cluster=1, start=start, exact=False))


def begins(job: work.Job) -> work.WorkOrder:
    return work_order(begin=(work.Assignment(job_id="c1", epoch=1, job=job),))


def refusal(message: Message, expected: type = Message) -> MalformedMessageError:
    kind = type(message) if expected is Message else expected
    with pytest.raises(MalformedMessageError) as refused:
        decode(encode(message), kind)
    return refused.value


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (changed(TRACKED, log_weight_sum=math.nan), "$.log_weight_sum"),
        (changed(TRACKED, effective_sample_size=math.inf), "$.effective_sample_size"),
        (changed(TRACKED, particles=0), "$.particles"),
        (changed(ELSEWHERE, log_likelihood=math.nan), "$.log_likelihood"),
        (changed(ELSEWHERE, step=-1), "$.step"),
        (changed(ELSEWHERE, epoch=-1), "$.epoch"),
        (begins(work.ElsewhereJob(first_step=-2)), "$.begin[0].job.first_step"),
        (begins(work.SearchJob(search=0, shard=0, first_step=-2)), "$.begin[0].job.first_step"),
        (changed(begins(SEARCH), resize=(("c1", 0, 5),)), "$.resize[0][1]"),
        (changed(begins(SEARCH), resize=(("c1", 2**40, 5),)), "$.resize[0][1]"),
        (changed(begins(SEARCH), resize=(("c1", 500, -2),)), "$.resize[0][2]"),
        (changed(TRACKED, step=-1), "$.step"),
        (changed(TRACKED, step=2**60), "$.step"),
        (changed(TRACKED, epoch=-1), "$.epoch"),
        (changed(TRACKED, pose=(math.nan, 0.0, 0.0)), "$.pose[0]"),
        (changed(TRACKED, covariance=(-1.0, *[0.0] * 8)), "$.covariance[0]"),
        (changed(TRACKED, snapshot=cloud(np.ones((2, 2)), np.zeros(2))), "float64 of (2, 2)"),
        (changed(TRACKED, snapshot=cloud(np.ones((3, 3)), np.zeros(2))), "float64 of (3, 3)"),
        (changed(TRACKED, snapshot=cloud(np.ones((0, 3)), np.zeros(0))), "without weight"),
        (changed(TRACKED, snapshot=cloud(np.full((2, 3), math.inf), np.zeros(2))), "not finite"),
        (changed(TRACKED, snapshot=cloud(np.ones((2, 3)), np.full(2, -math.inf))), "weight"),
        (changed(TRACKED, snapshot=cloud(np.ones((2, 3)), np.array([0, math.nan]))), "weight"),
        (changed(SEARCHED, log_evidence=math.nan), "$.log_evidence"),
        (changed(SEARCHED, places=found_places([(math.nan, ORIGIN)])), "not finite"),
        (changed(SEARCHED, places=found_places([(0.5, (1e12, 0.0, 0.0))])), "out of range"),
        (changed(scan(3), step=-1), "$.step"),
        (changed(scan(3), step=MAX_SCAN_STEP), "$.step"),
        (changed(scan(3), stamp_ns=2**63), "$.stamp_ns"),
        (changed(scan(3), odom_from_robot=(math.inf, 0.0, 0.0)), "$.odom_from_robot[0]"),
        (changed(scan(3), motion_by_scans=(math.inf, 0.0, 0.0)), "$.motion_by_scans[0]"),
        (changed(scan(3), ranges=ArrayBlob.of(np.full(3, np.nan), "float32")), "no_returns"),
        (changed(scan(3), angle_step_rad=math.nan), "$.angle_step_rad"),
        (ScanHistory(sender="b", scans=(scan(1), changed(scan(2), step=-2))), "$.scans[1].step"),
        (changed(ODOMETRY, odom_from_robot=(0.0, math.nan, 0.0)), "$.odom_from_robot[1]"),
        (TruePose(sender="s", step=1, pose=(math.nan, 0.0, 0.0)), "$.pose[0]"),
        (changed(SET_POSE, pose=(0.0, math.nan, 0.0)), "$.pose[1]"),
        (changed(SET_POSE, position_sigma_m=math.nan), "$.position_sigma_m"),
        (changed(SET_POSE, heading_sigma_rad=0.0), "$.heading_sigma_rad"),
        (changed(SET_POSE, command_id="x" * 129), "$.command_id"),
        (Relocalize(sender="a", command_id=""), "$.command_id"),
        (Relocalize(sender="a", command_id="1", near=(0.0, 0.0, 0.0)), "$.near[2]"),
        (Kidnap(sender="a", command_id="1", pose=(math.inf, 0.0, 0.0)), "$.pose[0]"),
        (order(cloud(np.full((2, 3), math.nan), np.zeros(2))), "not finite"),
        (changed(order(CLOUD), order=-5), "$.order"),
    ],
)  # fmt: skip
def test_implausible_numbers_are_refused(message: Message, words: str) -> None:
    error = refusal(message)
    assert words in error.problem
    kind = "field" if "$" in words else "impossible"
    assert error.cause == f"malformed {type(message).__name__}: {kind}"


def test_plausible_messages_are_accepted() -> None:
    order_of_nothing = begins(work.ElsewhereJob(first_step=-1))
    last = changed(scan(0), step=MAX_SCAN_STEP - 1)
    sound = (TRACKED, SEARCHED, ELSEWHERE, ODOMETRY, scan(0), last, SET_POSE, order(CLOUD))
    for message in (*sound, order_of_nothing):
        assert decode(encode(message), type(message)) == message


@pytest.mark.parametrize(
    "bomb",
    [
        pytest.param(b"\xdd\xff\xff\xff\xff", id="a list of four billion"),
        pytest.param(b"\xdf\xff\xff\xff\xff", id="a map of four billion"),
        pytest.param(b"\xdb\xff\xff\xff\xff", id="a text of four billion"),
        pytest.param(b"\x91" * 50_000, id="deep lists"),
        pytest.param(b"\x81\xa1a" * 20_000, id="deep maps"),
        pytest.param(b"\xdd\x00\x00\xff\xff" * 10_000, id="long lists in long lists"),
        pytest.param((b"\xdc\x4e\x20" + b"\x90" * 20_000) * 3, id="millions of empty lists"),
        pytest.param(b"\xd4\x05\x00", id="an extension"),
        pytest.param(b"", id="nothing"),
    ],
)
def test_data_that_would_need_much_memory_is_refused_while_decoding(bomb: bytes) -> None:
    with pytest.raises(MalformedMessageError) as refused:
        decode(bomb, work.WorkOrder)
    assert refused.value.kind == "not MessagePack"


def test_millions_of_empty_lists_are_refused_before_they_are_built() -> None:
    rows = b"\xdc\x4e\x20" + b"\x90" * MAX_ITEMS
    with pytest.raises(MalformedMessageError, match="lists and maps"):
        decode(b"\xdc\x01\x00" + rows * 256, work.WorkOrder)


def test_a_message_above_its_size_limit_is_refused() -> None:
    assert refusal(changed(SET_POSE, sender="x" * SMALL_BYTES)).kind == "too large"
    with pytest.raises(MalformedMessageError, match="the limit is 33554432"):
        decode(bytes(LARGEST_BYTES + 1), work.Report)  # type: ignore[arg-type] # a union


def test_a_later_version_is_distinguished_from_a_wrong_field() -> None:
    plain = msgspec.to_builtins(scan(1))
    later = msgspec.msgpack.encode(plain | {"schema": "scan/2"})
    wrong = msgspec.msgpack.encode(plain | {"step": "three"})
    kinds = []
    for data in (later, wrong):
        with pytest.raises(MalformedMessageError) as refused:
            decode(data, Scan)
        kinds.append(refused.value.cause)
    assert kinds == ["malformed Scan: schema", "malformed Scan: field"]


def test_text_from_the_wire_is_made_safe_for_the_log() -> None:
    plain = msgspec.to_builtins(scan(1)) | {"schema": "\x1b[2J\n" * 1000}
    with pytest.raises(MalformedMessageError) as refused:
        decode(msgspec.msgpack.encode(plain), Scan)
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 300


@pytest.mark.parametrize("shape", [(0,) * 100, (1,) * 65, (0, 2**63), (-1, -4), (2**40, 2**40)])
def test_an_array_whose_shape_disagrees_with_its_bytes_is_malformed(shape: tuple[int, ...]) -> None:
    data = b"\0\0\0\0" if shape[0] == 1 or shape[0] == -1 else b""
    with pytest.raises(MalformedMessageError) as refused:
        ArrayBlob(dtype="float32", shape=shape, data=data).array()
    assert refused.value.cause == "malformed array: wrong array"


@pytest.mark.parametrize("returned", [0, 3, 200, None])
def test_a_scan_is_usable_if_at_least_one_beam_returned(returned: int | None) -> None:
    """To look at the first few is enough for most scans, not for all."""
    ranges = np.full(201, 30.0)
    if returned is not None:
        ranges[returned] = 29.999
    blob = ArrayBlob.of(ranges, "float32")
    message = msgspec.structs.replace(scan(3), range_max_m=30.0, angle_step_rad=0.01, ranges=blob)
    assert scan_problem(message) == ("no_returns" if returned is None else None)


def test_a_step_that_observes_a_landmark_without_its_position_is_refused() -> None:
    seen = Seen(
        landmark="tag", mean=(1.0, 0.0), covariance=(0.01, 0.0, 0.0, 0.01),
        outlier_probability=0.05, share=1.0,
    )  # fmt: skip
    tag = Landmark(name="tag", x=1.0, y=2.0, sigma=0.1)
    step = msgspec.structs.replace(scan(3), observations=(seen,), landmarks=(tag,))
    assert scan_problem(step) is None
    assert scan_problem(msgspec.structs.replace(step, landmarks=())) == (
        "a landmark that is not on the map"
    )
