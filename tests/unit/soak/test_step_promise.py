from collections.abc import Iterable

import pytest

from tests.soak.promises import DoneFault, Outages, StepsOnce
from tests.soak.schedule import Kind
from tests.unit.soak.made_up import at, fault, outages


def published(steps: Iterable[int], known: Outages | None = None) -> StepsOnce:
    """A belief each second, of these steps."""
    promise = StepsOnce(known or outages(), longest_s=2.0)
    for second, step in enumerate(steps):
        promise.on_belief(at(second), step)
    return promise


@pytest.mark.parametrize(
    ("steps", "faults", "kept"),
    [
        ([4, 5, 6], [], True),
        ([1, 2, 2], [], False),
        ([1, 2, 5], [fault(Kind.WORKER_KILLED, 1.5)], False),
    ],
    ids=["each step once", "a step twice", "a killed worker excuses no lost step"],
)
def test_the_promise_is_kept_by_steps_that_come_once(
    steps: list[int], faults: list[DoneFault], kept: bool
) -> None:
    assert published(steps, outages(*faults)).verdict().kept is kept


def test_a_step_that_is_missing_is_lost() -> None:
    verdict = published([1, 2, 5]).verdict()
    assert [broken.what for broken in verdict.breaks] == ["2 steps before step 5 are lost"]
    assert verdict.figures["lost"] == 2


def test_a_step_lost_while_the_network_is_down_is_excused_and_counted() -> None:
    verdict = published([1, 2, 5], outages(fault(Kind.ROUTER_KILLED, 1.5))).verdict()
    assert verdict.kept is True
    assert verdict.figures["lost_in_outages"] == 2


def test_a_new_coordinator_may_publish_a_belief_again() -> None:
    promise = published([1, 2, 2], outages(fault(Kind.COORDINATOR_KILLED, 1.5)))
    assert promise.verdict().kept is True
    assert promise.verdict().figures["repeated"] == 1


def test_a_step_that_takes_too_long_breaks_it() -> None:
    promise = StepsOnce(outages(), longest_s=2.0)
    for step, delay_s in ((1, 0.5), (2, 2.5)):
        promise.on_scan(at(10.0 * step), step)
        promise.on_belief(at(10.0 * step + delay_s), step)
    assert [broken.what for broken in promise.verdict().breaks] == ["step 2 took 2.50 s"]
    assert promise.verdict().figures["longest_s"] == 2.5
