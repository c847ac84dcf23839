import msgspec

from benchmarks.experiments.case import AfterStep, Case, OnceRight, SimulatedRobot
from benchmarks.experiments.observer import GOOD_BEFORE_KIDNAP, Observer
from robot_simulator.worlds.catalogue import world
from tests.unit.benchmarks.experiments.made_up import NOWHERE, TRUTH, at, case
from tests.unit.coordinator.reports import scan
from tests.unit.evaluation.places import outcome

SCAN = scan(0)


def observer(of: Case) -> Observer:
    return Observer(of, world("rectangle").map)


RIGHT = outcome("localized", at(0.8), at(0.2, NOWHERE))
WRONG = outcome("localized", at(1.0, NOWHERE))


def lifted(kidnapping: AfterStep | OnceRight) -> SimulatedRobot:
    return SimulatedRobot(world="rectangle", kidnapping=kidnapping)


def test_the_robot_is_kidnapped_after_enough_right_estimates_in_a_row() -> None:
    watching = observer(case(robot=lifted(OnceRight(at_latest=500)), updates_after_event=3))
    for made in [RIGHT, WRONG, *[RIGHT] * (GOOD_BEFORE_KIDNAP - 1)]:
        watching.on_step(SCAN, made, TRUTH)
        assert not watching.kidnap_now
    watching.on_step(SCAN, RIGHT, TRUTH)
    assert watching.kidnap_now
    watching.kidnapped()
    for _ in range(3):
        assert not watching.over
        assert not watching.kidnap_now
        watching.on_step(SCAN, WRONG, TRUTH)
    assert watching.over
    measures = watching.measures(1.0)
    assert measures.kidnapped_at_update == GOOD_BEFORE_KIDNAP + 2
    assert measures.right_before_kidnap is True


def test_steps_without_a_known_truth_are_updates_but_not_judged() -> None:
    watching = observer(case())
    watching.on_step(SCAN, RIGHT, None)
    watching.on_step(msgspec.structs.replace(SCAN, step=1), RIGHT, TRUTH)
    measures = watching.measures(1.0)
    assert measures.updates == 2
    assert measures.right_share == 1.0
    assert measures.bootstrap_update == 2
    assert watching.calibration[0].sum() == 1
