"""No checkpoint that cannot be, and no term that cannot, ends a coordinator or its belief."""

import math
import time
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from coordinator.coordinator import Coordinator
from coordinator.recovery import UNSEEN_NS, Term
from particle_filter.sensor_model import SensorModel
from protocol.answers import Belief
from protocol.errors import MalformedMessageError
from protocol.terms import MAX_RELAYED_AHEAD_US, check_term
from protocol.work import OrderAnswer, TakeOver
from tests.unit.coordinator.living import Living, symmetric_room

LAST = 13
ANY_ORDER = TakeOver(sender="coordinator", term=0)


@pytest.fixture(scope="module")
def model() -> SensorModel:
    return symmetric_room()


def lived(model: SensorModel) -> Living:
    living = Living(model)
    for step in range(LAST + 1):
        living.drive(step)
    return living


def counters(living: Living) -> dict[str, int]:
    assert living.coordinator is not None
    return living.coordinator.status(10**12, {}).counters


def essence(belief: Belief) -> tuple[object, ...]:
    return (
        belief.state, belief.hypotheses, belief.elsewhere_probability, belief.searching,
        belief.missing,
    )  # fmt: skip


Tree = dict[str, Any]


def nan_covariance(tree: Tree) -> None:
    first = next(iter(tree["ensemble"]["clusters"]["clusters"].values()))
    first["covariance"] = [math.nan] * 9


def nan_odometry(tree: Tree) -> None:
    tree["collector"]["applied"]["odom_from_robot"] = [math.nan, 0.0, 0.0]


def far_step(tree: Tree) -> None:
    tree["collector"]["applied"]["step"] = 2**62


def elsewhere_later(tree: Tree) -> None:
    """Every step would wait for the job that weighs scans elsewhere."""
    tree["jobs"]["placed"]["e0"]["job"]["first_step"] = 2**40


def surely_elsewhere(tree: Tree) -> None:
    tree["ensemble"]["clusters"]["log_elsewhere"] = 0.0


def infinitely_old(tree: Tree) -> None:
    tree["age_s"] = math.inf


POISONS = [
    nan_covariance, nan_odometry, far_step, elsewhere_later, surely_elsewhere, infinitely_old,
]  # fmt: skip


@pytest.mark.parametrize("poison", POISONS)
def test_an_impossible_state_is_ignored_and_the_file_is_used(
    model: SensorModel, poison: Callable[[Tree], None]
) -> None:
    living = lived(model)
    before, last = living.beliefs[LAST][-1], living.kept
    assert last is not None
    tree = msgspec.msgpack.decode(last.state)
    poison(tree)
    living.revive(known=replace(last, serial=2**40, state=msgspec.msgpack.encode(tree)))
    after = living.beliefs[LAST][-1]
    assert (essence(after), after.term > before.term) == (essence(before), True)
    assert counters(living)["checkpoint that cannot be read"] == 1
    living.drive(LAST + 1)
    assert living.beliefs[LAST + 1][-1].missing == ()


def claim(living: Living, term: int) -> Coordinator:
    """Return the coordinator after a worker has claimed to know a term."""
    coordinator = living.coordinator
    assert coordinator is not None
    forged = OrderAnswer(sender="w0", order=1, jobs=(), term=term)
    living.answer_order("w0", forged)
    living.settle()
    return coordinator


def test_a_worker_that_claims_a_higher_term_deposes_no_coordinator(model: SensorModel) -> None:
    living = lived(model)
    before = living.beliefs[LAST][-1]
    forged = before.term + 7
    coordinator = claim(living, forged)
    living.wait(UNSEEN_NS / 1e9)
    living.drive(LAST + 1)
    after = living.beliefs[LAST + 1][-1]
    assert coordinator.term.outranked_by is None
    assert after.missing == ()
    assert after.term > forged, "workers obey it also if the claim was true"
    newest = max(place.cluster for place in before.hypotheses)
    assert max(place.cluster for place in after.hypotheses) >= newest, "it did not begin again"


def test_a_worker_cannot_claim_the_highest_possible_term() -> None:
    claimed = OrderAnswer(sender="w", order=1, jobs=(), term=2**53 - 1)
    with pytest.raises(MalformedMessageError, match="term 9007199254740991 is over 75 years"):
        check_term(claimed, time.time_ns())


def test_a_claimed_term_leaves_room_for_higher_terms() -> None:
    claimed, clock_ns = OrderAnswer(sender="w", order=1, jobs=(), term=0), 0
    term = Term.of(1_000)
    for _ in range(100):
        claimed = replace(claimed, term=MAX_RELAYED_AHEAD_US)
        check_term(claimed, clock_ns)
        term.on_term(claimed.term)
        assert not term.on_term(term.number)
    check_term(replace(ANY_ORDER, term=term.number), clock_ns)
