from soak_test.true_poses import TruePoses
from tests.unit.soak_test.hear import at, belief, place

POSE = (1.0, 2.0, 0.5)


def test_a_belief_meets_its_truth_whichever_comes_first() -> None:
    poses = TruePoses()
    assert poses.truth(at(1.0), POSE) is None
    first = poses.on_belief(at(1.1), belief(1, stamp_s=1.0))
    assert first is not None
    assert (first.at_ns, first.belief.step, first.truth) == (at(1.1), 1, POSE)
    assert poses.on_belief(at(2.1), belief(2, stamp_s=2.0)) is None
    second = poses.truth(at(2.0), POSE)
    assert second is not None
    assert (second.at_ns, second.belief.step) == (at(2.1), 2)
    assert poses.unknown == 0


def test_beliefs_whose_truth_never_comes_are_counted() -> None:
    poses = TruePoses()
    for step in range(66):
        assert poses.on_belief(at(step), belief(step, stamp_s=step)) is None
    assert poses.unknown == 2  # 64 may still wait


def test_a_belief_is_blind_if_nobody_reported_to_it() -> None:
    poses = TruePoses()
    places = place(0, 0.5), place(1, 0.5)
    poses.truth(at(1.0), POSE)
    blind = [
        heard.blind
        for missing in ((), ("c0",), ("c0", "c1"))
        if (heard := poses.on_belief(at(1.1), belief(1, *places, stamp_s=1.0, missing=missing)))
    ]
    assert blind == [False, False, True]
    nothing = poses.on_belief(at(1.1), belief(1, stamp_s=1.0))
    assert nothing is not None
    assert not nothing.blind
