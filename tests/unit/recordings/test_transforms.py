import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from clustermcl.filter.poses import compose, inverse
from clustermcl.protocol.message import PoseTuple
from clustermcl.recordings.rigid import IDENTITY, Rigid, flat
from clustermcl.recordings.transforms import (
    CACHE_NS,
    LATE_NS,
    RESTART_AFTER,
    Kept,
    TransformMissingError,
    TransformTree,
)

SECOND = 1_000_000_000
OVERHEAD = Rigid(0.2, 0.1, 0.3, 1.0, 0.0, 0.0, 0.0)

numbers = st.floats(-20.0, 20.0)
poses = st.tuples(numbers, numbers, st.floats(-3.1, 3.1))
turns = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: math.hypot(*q) > 0.1)


def rigids() -> st.SearchStrategy[Rigid]:
    def made(shift: PoseTuple, turn: tuple[float, ...]) -> Rigid:
        return Rigid(*shift, *(part / math.hypot(*turn) for part in turn))

    return st.builds(made, st.tuples(numbers, numbers, numbers), turns)


def driving() -> TransformTree:
    """odom -> base moves one metre a second from time 10 s to 12 s; base -> laser is fixed."""
    frames = TransformTree()
    for tick in range(11):
        at = flat((0.2 * tick, 0.0, 0.0))
        frames.add(10 * SECOND + tick * SECOND // 5, "odom", "base", at, fixed=False)
    frames.add(0, "base", "laser", OVERHEAD, fixed=True)
    return frames


def missing(frames: TransformTree, outer: str, inner: str, stamp_ns: int) -> TransformMissingError:
    with pytest.raises(TransformMissingError) as raised:
        frames.lookup(outer, inner, stamp_ns)
    return raised.value


def test_lookups_go_up_down_and_across_the_tree() -> None:
    frames = driving()
    frames.add(0, "base", "camera", flat((-0.2, 0.0, 0.0)), fixed=True)
    at_ns = 11 * SECOND
    assert frames.lookup("odom", "laser", at_ns)[:3] == pytest.approx((1.2, 0.1, 0.3))
    assert frames.lookup("camera", "laser", at_ns)[:3] == pytest.approx((0.4, 0.1, 0.3))
    assert frames.lookup("base", "odom", at_ns).planar() == pytest.approx((-1.0, 0.0, 0.0))
    assert frames.lookup("laser", "laser", 0) == IDENTITY
    assert frames.lookup("base", "laser", 0).up() == pytest.approx(-1.0)
    assert frames.lookup("odom", "base", 10_500_000_000).x == pytest.approx(0.5)


@pytest.mark.parametrize(("outer", "inner", "stamp_ns", "may_come", "problem"), [
    ("odom", "laser", 12_350_000_000, True, "tf from 'odom' to 'base' ends 0.350 s before"),
    ("base", "laser2", 11 * SECOND, True, "no transform from 'base' to 'laser2'; tf has odom -> "),
    ("odom", "base", 9 * SECOND, False, "tf from 'odom' to 'base' begins 1.000 s after"),
])  # fmt: skip
def test_a_missing_transform_is_named_and_may_come_unless_it_is_older_than_all(
    outer: str, inner: str, stamp_ns: int, may_come: bool, problem: str
) -> None:
    raised = missing(driving(), outer, inner, stamp_ns)
    assert raised.may_come == may_come
    assert str(raised).startswith(problem)


def test_a_loop_is_named_in_the_error() -> None:
    frames = TransformTree()
    for parent, child in (("a", "b"), ("b", "c"), ("c", "a")):
        frames.add(0, parent, child, IDENTITY, fixed=True)
    assert str(missing(frames, "odom", "b", 0)) == "tf loops: b -> c -> a -> b"
    frames.add(0, "odom", "a", IDENTITY, fixed=True)  # and mended
    assert frames.lookup("odom", "c", 0) == IDENTITY


def test_the_newest_time_is_that_of_the_slowest_link() -> None:
    frames = driving()
    assert frames.newest_ns("odom", "laser") == 12 * SECOND
    frames.add(11 * SECOND, "laser", "tip", IDENTITY, fixed=False)
    assert frames.newest_ns("odom", "tip") == 11 * SECOND
    assert frames.newest_ns("base", "laser") is None
    assert frames.newest_ns("odom", "nowhere") is None


def test_a_late_transform_is_refused_and_many_in_a_row_reset_the_tree() -> None:
    frames = driving()
    early = 12 * SECOND - LATE_NS - 100
    kept = [
        frames.add(early + tick, "odom", "base", IDENTITY, fixed=False)
        for tick in range(RESTART_AFTER)
    ]
    assert kept == [Kept.NO] * (RESTART_AFTER - 1) + [Kept.CLOCK_SET_BACK]
    assert frames.newest_ns("odom", "base") == early + RESTART_AFTER - 1
    assert frames.lookup("base", "laser", 0) == OVERHEAD  # what is fixed stays
    many = [frames.add(0, "odom", f"frame {n}", IDENTITY, fixed=True) for n in range(1001)]
    assert many.index(Kept.NO) == 998, "with odom -> base and base -> laser a thousand"


def test_a_tree_of_a_recording_keeps_all_transforms_and_extends_its_ends() -> None:
    frames = TransformTree(cache_ns=None, slack_ns=SECOND // 4)
    for second in (100, 0, 50):
        frames.add(second * SECOND, "odom", "base", flat((second, 0.0, 0.0)), fixed=False)
    assert frames.lookup("odom", "base", 25 * SECOND).x == pytest.approx(25.0)
    assert frames.lookup("odom", "base", 100 * SECOND + SECOND // 4).x == 100.0
    assert frames.lookup("odom", "base", -SECOND // 4).x == 0.0
    assert not missing(frames, "odom", "base", -SECOND // 4 - 1).may_come


def test_old_transforms_are_dropped_after_a_while_and_all_but_the_newest_at_a_jump() -> None:
    frames = driving()
    frames.add(12 * SECOND + CACHE_NS, "odom", "base", flat((50.0, 0.0, 0.0)), fixed=False)
    assert not missing(frames, "odom", "base", 11 * SECOND).may_come
    assert frames.lookup("odom", "base", 12 * SECOND).x == pytest.approx(2.0)
    frames.keep_newest()
    assert not missing(frames, "odom", "base", 12 * SECOND).may_come
    assert frames.lookup("odom", "base", 12 * SECOND + CACHE_NS).x == 50.0


def test_a_child_may_get_another_parent() -> None:
    frames = driving()
    frames.add(0, "mast", "laser", IDENTITY, fixed=True)
    frames.add(0, "base", "mast", flat((1.0, 0.0, 0.0)), fixed=True)
    assert frames.lookup("base", "laser", 0).x == 1.0


@given(outer=rigids(), inner=rigids())
def test_composition_and_inverse_agree_with_scipys_rotations(outer: Rigid, inner: Rigid) -> None:
    expected = Rotation.from_quat(outer[3:]) * Rotation.from_quat(inner[3:])
    chained = outer.of(inner)
    assert (expected.inv() * Rotation.from_quat(chained[3:])).magnitude() < 1e-9
    np.testing.assert_allclose(
        chained[:3], outer[:3] + Rotation.from_quat(outer[3:]).apply(inner[:3]), atol=1e-9
    )
    np.testing.assert_allclose(outer.inverse().of(chained)[:3], inner[:3], atol=1e-9)


@given(start=rigids(), end=rigids(), share=st.floats(0.0, 1.0))
def test_interpolation_agrees_with_scipys_slerp(start: Rigid, end: Rigid, share: float) -> None:
    ends = Rotation.from_quat([start[3:], end[3:]])
    if (ends[0].inv() * ends[1]).magnitude() > 3.1:  # which way round is a matter of rounding
        return
    between = Rotation.from_quat(start.towards(end, share)[3:])
    assert (Slerp([0.0, 1.0], ends)(share).inv() * between).magnitude() < 1e-6


@given(outer=poses, inner=poses)
def test_planar_transforms_compose_like_poses_of_the_filter(
    outer: PoseTuple, inner: PoseTuple
) -> None:
    expected = compose(np.array(outer), np.array(inner))
    np.testing.assert_allclose(flat(outer).of(flat(inner)).planar(), expected, atol=1e-9)
    back = inverse(np.array(outer))
    np.testing.assert_allclose(flat(outer).inverse().planar(), back, atol=1e-9)
