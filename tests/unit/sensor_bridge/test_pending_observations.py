import math
from collections import Counter
from collections.abc import Iterable

import msgspec
import numpy as np
import pytest

from clustermcl.filter.grid import Grid
from clustermcl.filter.observations.field import Field
from clustermcl.filter.observations.fixes import PoseFix, PositionFix
from clustermcl.filter.observations.kind import Kind, Landmarks
from clustermcl.filter.observations.likelihood import log_likelihood_ratio
from clustermcl.filter.observations.sighting import Sighting
from clustermcl.jobs.wire_observations import from_wire, to_wire
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.causes import AnyCause, Cause
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.steps import (
    MAX_FIELDS,
    MAX_OBSERVATIONS,
    Landmark,
    Observation,
    PositionField,
    Seen,
)
from clustermcl.sensor_bridge.pending_observations import MAX_NAT, MAX_WAITING, PendingObservations
from clustermcl.sensor_bridge.sources import LEAST_OUTLIER_PROBABILITY, NEW_SENDERS

SECOND = 1_000_000_000
TAGS = (Landmark(name="tag", x=1.0, y=2.0, sigma=0.1),)
GRID = Grid(np.zeros((1, 1), np.int8), 100.0, np.zeros(3))
EVEN = (0.01, 0.0, 0.0, 0.01)


def seen(at_s: float, x: float = 2.0, y: float = 0.0, name: str = "tag") -> Observation:
    stamp_ns = round(at_s * SECOND)
    return Observation(sender="eye", stamp_ns=stamp_ns, landmark=name, mean=(x, y), covariance=EVEN)


def driven(sights: PendingObservations, until_s: int, speed: float = 1.0) -> None:
    for second in range(until_s + 1):
        sights.moved(second * SECOND, (speed * second, 0.0, 0.0))


def sights_after_5_s() -> tuple[PendingObservations, Counter[AnyCause]]:
    """With the counter of what is dropped, by its cause."""
    dropped = Counter[AnyCause]()
    sights = PendingObservations(TAGS, dropped)
    driven(sights, 5)
    return sights, dropped


def taken(*observations: Observation) -> tuple[tuple[Seen, ...], Counter[AnyCause]]:
    """Of observations after 5 s, what is in a step after 6 s, and what is dropped."""
    sights, dropped = sights_after_5_s()
    for observation in observations:
        sights.on_observation(observation)
    driven(sights, 6)
    return sights.take(0, (6.0, 0.0, 0.0)), dropped


def shares_of(observations: Iterable[Observation], speed: float = 0.0) -> list[float]:
    """Of observations by a driving robot, each taken into a step at once."""
    sights, shares = PendingObservations(TAGS, Counter()), list[float]()
    for seen_now in observations:
        pose = (speed * seen_now.stamp_ns / SECOND, 0.0, 0.0)
        sights.on_observation(seen_now)
        sights.moved(seen_now.stamp_ns, pose)
        shares += [each.share for each in sights.take(0, pose)]
    return shares


def test_an_observation_is_moved_to_the_pose_of_the_step() -> None:
    sights = PendingObservations(TAGS, Counter())
    sights.on_observation(seen(0.5))
    driven(sights, 1)
    (moved,) = sights.take(0, (1.0, 0.0, 0.0))
    assert moved.mean == pytest.approx((1.5, 0.0))
    assert moved.share == 1.0
    assert sights.landmarks_of([moved]) == TAGS
    assert sights.take(0, (1.0, 0.0, 0.0)) == ()


def test_observations_of_one_tag_over_a_minute_are_not_independent() -> None:
    first, *later = shares_of(seen(second) for second in range(60))
    assert first == 1.0
    assert 0.5 < sum(later) < 3.0


def test_a_wrong_name_or_another_sender_does_not_make_an_observation_new() -> None:
    sights = PendingObservations(
        (*TAGS, Landmark(name="other", x=5.0, y=5.0, sigma=0.1)), Counter()
    )
    driven(sights, 0)
    sights.on_observation(seen(0.0))
    sights.on_observation(seen(0.0, name="other"))
    sights.on_observation(msgspec.structs.replace(seen(0.0), sender="another eye"))
    sights.on_observation(seen(0.0, y=1.5, name="other"))
    sights.moved(0, (0.0, 0.0, 0.0))
    assert [(each.mean[1], each.share) for each in sights.take(0, (0.0, 0.0, 0.0))] == [
        (0.0, 1.0),
        (1.5, 1.0),
    ]


def test_later_observations_of_the_same_tag_weigh_less() -> None:
    """A tag that was moved is wrong at every sight, however far the robot drives meanwhile."""
    shares = shares_of((seen(second, x=5.0 - 0.1 * second) for second in range(30)), speed=0.1)
    assert shares[0] == 1.0
    assert shares == sorted(shares, reverse=True)
    assert sum(shares) < 1.0 + math.log(1.0 + len(shares))


def test_unusable_observations_are_counted_by_cause() -> None:
    _, dropped = taken(seen(5.0, name="nobody"), seen(60.0), seen(-60.0))
    assert dropped == {Cause.UNKNOWN_LANDMARK: 1, Cause.AHEAD: 1, Cause.NO_ODOMETRY: 1}


def test_a_flood_of_observations_is_bounded_and_clocks_ahead_take_no_place() -> None:
    ahead = [seen(14.0, x=float(number)) for number in range(MAX_WAITING)]
    in_step, dropped = taken(*ahead, *(seen(5.5, x=3.0 * number) for number in range(1000)))
    assert len(in_step) == MAX_OBSERVATIONS
    assert dropped == {Cause.TOO_MANY: MAX_WAITING + 1000 - MAX_OBSERVATIONS}


def fix(sender: str, **change: object) -> Observation:
    return msgspec.structs.replace(seen(5.0), sender=sender, landmark="", **change)


def test_poses_of_all_senders_share_the_weight_of_one() -> None:
    in_step, _ = taken(*(fix(f"gnss {number}") for number in range(4)))
    assert [each.share for each in in_step] == pytest.approx([1.0, 1.0 / 2.0, 1.0 / 3.0, 1.0 / 4.0])


def test_a_new_source_is_not_believed_to_be_never_wrong() -> None:
    ((new,), _) = taken(fix("gnss", outlier_probability=1e-6))
    assert new.outlier_probability == LEAST_OUTLIER_PROBABILITY


def test_the_observations_of_one_step_add_a_bounded_log_likelihood() -> None:
    """A camera whose mount is wrong sees all its tags in wrong places."""
    tags = [Landmark(name=str(n), x=3.0 * n, y=0.0, sigma=0.05) for n in range(MAX_OBSERVATIONS)]
    sights = PendingObservations(tags, Counter())
    for tag in tags:
        sights.on_observation(seen(0.0, x=tag.x, name=tag.name))
    driven(sights, 1, speed=0.0)
    in_step = sights.take(0, (0.0, 0.0, 0.0))
    assert len(in_step) == MAX_OBSERVATIONS
    observed = [from_wire(each, each.share) for each in in_step]
    landmarks = Landmarks.of((tag.name, tag.x, tag.y, tag.sigma) for tag in tags)
    at_the_best = log_likelihood_ratio(np.zeros((1, 3)), observed, landmarks, GRID)
    assert at_the_best == pytest.approx(MAX_NAT, rel=1e-2)


def test_more_than_a_few_new_senders_a_minute_are_dropped() -> None:
    sights, dropped = sights_after_5_s()
    for number in range(50_000):
        sights.on_observation(fix(f"name {number}"))
    assert dropped[Cause.MANY_SOURCES] == 50_000 - NEW_SENDERS
    sights.on_observation(fix("name 0"))
    driven(sights, 65)
    sights.on_observation(fix("a late one", stamp_ns=65 * SECOND))
    assert dropped == {Cause.MANY_SOURCES: 50_000 - NEW_SENDERS}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mean": (float("nan"), 0.0)}, "mean"),
        ({"mean": (1e9, 0.0)}, "out of range"),
        ({"mean": (1.0, 0.0, 0.0)}, "3 numbers with a covariance of 4"),
        ({"covariance": (0.01, 0.0, 0.0, -0.01)}, "not positive definite"),
        ({"covariance": (0.01, 0.02, 0.02, 0.01)}, "not positive definite"),
        ({"covariance": (0.01, 0.005, 0.0, 0.01)}, "not symmetric"),
        ({"covariance": (0.01, 0.0, 0.0)}, "covariance of 3"),
        ({"outlier_probability": 0.0}, "outlier_probability"),
        ({"stamp_ns": 2**62}, "stamp_ns"),
        ({"correlation_s": -1.0}, "correlation_s"),
    ],
)
def test_an_impossible_observation_is_refused(change: dict[str, object], words: str) -> None:
    fields = {"sender": "eye", "stamp_ns": 1, "landmark": "tag", "mean": (1.0, 0.0)}
    fields |= {"covariance": EVEN, **change}
    with pytest.raises(MalformedMessageError, match=words):
        decode(encode(Observation(**fields)), Observation)  # type: ignore[arg-type]


def field(values: object, cell_m: float = 5.0, **change: object) -> PositionField:
    blob = ArrayBlob.of(np.asarray(values), "float32")
    blob = msgspec.structs.replace(blob, **change)
    return PositionField(cell_m=cell_m, log_likelihoods=blob)


def region(at_s: float, **change: object) -> Observation:
    usual = {"landmark": "", "field": field(np.zeros((2, 3)))}
    return msgspec.structs.replace(seen(at_s), **(usual | change))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"field": field(np.full((2, 2), np.nan))}, "not finite"),
        ({"field": field(np.zeros((65, 1)))}, "64 x 64"),
        ({"field": field(np.zeros((0, 5)))}, "64 x 64"),
        ({"field": field(np.zeros(5))}, "expected float32"),
        ({"field": field(np.zeros((2, 2)), shape=(2, 2**40))}, "do not fill"),
        ({"field": field(np.zeros((2, 2)), shape=(2, 1), dtype="float64")}, "expected float32"),
        ({"field": field(np.zeros((2, 2)), cell_m=0.0)}, "cell_m"),
        ({"landmark": "tag"}, "with a landmark or a heading"),
        (
            {"mean": (1.0, 2.0, 3.0), "covariance": (1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0)},
            "with a landmark or a heading",
        ),
    ],
)
def test_an_impossible_field_is_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(MalformedMessageError, match=words):
        decode(encode(region(1.0, **change)), Observation)


@pytest.mark.parametrize(
    ("message", "kind"),
    [
        (seen(0.0), Sighting),
        (fix("gnss"), PositionFix),
        (fix("slam", mean=(1.0, 2.0, 0.5), covariance=tuple(np.eye(3).ravel())), PoseFix),
        (region(0.0), Field),
    ],
)
def test_a_message_is_of_one_kind_and_comes_back_unchanged(
    message: Observation, kind: type[Kind]
) -> None:
    known = from_wire(message, 0.5)
    assert type(known) is kind
    again = msgspec.structs.asdict(to_wire(known, known.share))
    assert again.pop("share") == 0.5
    assert again == {name: getattr(message, name) for name in again}


def test_a_field_reaches_the_step_and_its_error_grows_with_the_motion_since() -> None:
    sights = PendingObservations((), Counter(), "map")
    sights.on_observation(region(0.5))
    driven(sights, 1)
    (moved,) = sights.take(0, (1.0, 0.0, 0.0))
    assert moved.field == field(np.zeros((2, 3)))
    assert (moved.mean, moved.share) == ((2.0, 0.0), 1.0)
    assert moved.covariance == pytest.approx((0.26, 0.0, 0.0, 0.26))


def test_fields_of_another_map_and_too_many_fields_are_dropped() -> None:
    dropped = Counter[AnyCause]()
    sights = PendingObservations((), dropped, "map")
    for digest in ("map", "other"):
        of_map = msgspec.structs.replace(field(np.zeros((1, 1))), map_digest=digest)
        sights.on_observation(region(0.0, field=of_map, sender=digest))
    for number in range(MAX_FIELDS):
        sights.on_observation(region(0.0, sender=str(number)))
    driven(sights, 0)
    assert len(sights.take(0, (0.0, 0.0, 0.0))) == MAX_FIELDS
    assert dropped == {Cause.OTHER_FIELD: 1, Cause.TOO_MANY: 1}


def test_fields_at_one_place_repeat_a_systematic_error() -> None:
    """Wi-Fi of a standing robot points to the same wrong room for ever."""
    standing, driving = (
        sum(shares_of(map(region, range(0, 600, 10)), speed)) for speed in (0.0, 0.3)
    )
    assert 1.0 < standing < 1.0 + math.log(60.0)
    assert driving > 10.0


def test_an_observation_moved_out_of_range_does_not_spoil_the_step() -> None:
    dropped = Counter[AnyCause]()
    sights = PendingObservations(TAGS, dropped)
    sights.on_observation(seen(0.0, x=1e8 - 0.5))
    sights.on_observation(seen(0.0))
    driven(sights, 1, speed=-1.0)
    (kept,) = sights.take(0, (-1.0, 0.0, 0.0))
    assert kept.mean == pytest.approx((3.0, 0.0))
    assert dropped == {Cause.TOO_FAR_BACK: 1}
