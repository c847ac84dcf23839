from benchmarks.advice import Obstacles, place_of, run
from tests.unit.evaluation.places import straight_way

CROSS = place_of("cross_feature")


def test_no_advised_pose_is_near_an_obstacle() -> None:
    made = run(CROSS, 6, 60, advised=True)
    assert made.checked > 5_000
    assert made.unsafe == 0


def test_a_way_through_a_wall_is_counted() -> None:
    way = straight_way(3.8)
    checked, unsafe = Obstacles(CROSS.map).count_unsafe(way, [(0.0, -4.0, 0.0)])
    assert checked == 4 * (len(way.poses) - 1)
    assert unsafe > checked // 3
