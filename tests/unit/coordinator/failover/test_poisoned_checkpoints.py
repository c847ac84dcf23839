"""Neither a checkpoint that cannot be nor a worker that lies ends a coordinator or its belief."""

import math
from collections.abc import Callable

import pytest
from msgspec.structs import replace

from coordinator.checkpoint import CheckpointState, from_bytes, to_bytes
from coordinator.coordinator import Coordinator
from coordinator.events import CheckpointHeard
from particle_filter.sensor_model import SensorModel
from protocol.answers import Belief
from protocol.codec import decode, encode
from protocol.work import Checkpoint, ElsewhereJob, OrderAnswer
from tests.unit.coordinator.living import Living, symmetric_room
from worker import events as worker_events

LAST = 13
KEY = b"k" * 32


@pytest.fixture(scope="module")
def model() -> SensorModel:
    return symmetric_room()


def lived(model: SensorModel, key: bytes | None = None) -> Living:
    living = Living(model, key=key)
    for step in range(LAST + 1):
        living.drive(step)
    return living


def last_of(living: Living) -> Checkpoint:
    return decode(living.state("w0").checkpoint, Checkpoint)


def publish(living: Living, checkpoint: Checkpoint) -> None:
    """As a stranger does: all workers hear it, and the coordinator as far as it believes it."""
    payload = encode(checkpoint)
    for name in living.workers:
        living.tell_worker(name, worker_events.CheckpointHeard(checkpoint, payload))
    assert living.coordinator is not None
    if living.trust.believes(checkpoint):
        living.coordinator.handle(CheckpointHeard(checkpoint), 10**12)


def counters(living: Living) -> dict[str, int]:
    assert living.coordinator is not None
    return living.coordinator.status(10**12, {}).counters


def essence(belief: Belief) -> tuple[object, ...]:
    return (
        belief.state, belief.hypotheses, belief.elsewhere_probability, belief.searching,
        belief.missing,
    )  # fmt: skip


def nan_covariance(state: CheckpointState) -> CheckpointState:
    first, *rest = state.ensemble.clusters
    poisoned = replace(first, covariance=(math.nan,) * 9)
    return replace(state, ensemble=replace(state.ensemble, clusters=(poisoned, *rest)))


def nan_odometry(state: CheckpointState) -> CheckpointState:
    applied = state.collector.applied
    assert applied is not None
    poisoned = replace(applied, odom_from_robot=(math.nan, 0.0, 0.0))
    return replace(state, collector=replace(state.collector, applied=poisoned))


def far_step(state: CheckpointState) -> CheckpointState:
    applied = state.collector.applied
    assert applied is not None
    return replace(state, collector=replace(state.collector, applied=replace(applied, step=2**62)))


def with_elsewhere(state: CheckpointState, log_probability: float) -> CheckpointState:
    return replace(state, ensemble=replace(state.ensemble, log_elsewhere=log_probability))


def elsewhere_later(state: CheckpointState) -> CheckpointState:
    """Who weighs scans elsewhere would be waited for at every step for ever."""
    jobs = [
        replace(job, job=replace(job.job, first_step=2**40))
        if isinstance(job.job, ElsewhereJob)
        else job
        for job in state.jobs
    ]
    return replace(state, jobs=tuple(jobs))


POISONS: list[Callable[[CheckpointState], CheckpointState]] = [
    nan_covariance,
    nan_odometry,
    far_step,
    elsewhere_later,
    lambda state: with_elsewhere(state, math.nan),
    lambda state: with_elsewhere(state, 1e9),
    lambda state: with_elsewhere(state, 0.0),
    lambda state: replace(state, age_s=math.nan),
    lambda state: replace(state, age_s=math.inf),
]


@pytest.mark.parametrize("above", [(0, 2**40), (1, 0)], ids=["same term", "next term"])
@pytest.mark.parametrize("poisoned", POISONS)
def test_a_poisoned_checkpoint_is_left_out_and_the_next_best_is_used(
    model: SensorModel,
    poisoned: Callable[[CheckpointState], CheckpointState],
    above: tuple[int, int],
) -> None:
    living = lived(model)
    before, last = living.beliefs[LAST][-1], last_of(living)
    state = to_bytes(poisoned(from_bytes(last.state)))
    terms, serials = above
    publish(living, replace(last, term=last.term + terms, serial=serials, state=state))
    living.revive()
    after = living.beliefs[LAST][-1]
    assert (essence(after), after.term > before.term) == (essence(before), True)
    assert counters(living)["checkpoint of an impossible state"] == 1
    living.drive(LAST + 1)
    assert living.beliefs[LAST + 1][-1].missing == ()


def test_poison_that_goes_on_for_twenty_steps_is_left_out_as_well(model: SensorModel) -> None:
    """Workers go on to keep what the coordinator confirms, although another ranks higher."""
    living = lived(model)
    last = last_of(living)
    publish(living, replace(last, serial=2**40, state=b"rubbish"))
    for step in range(LAST + 1, LAST + 21):
        living.drive(step)
    before = living.beliefs[LAST + 20][-1]
    living.revive()
    assert essence(living.beliefs[LAST + 20][-1]) == essence(before)
    told = counters(living)
    told.pop("report late", None)  # those on the newest step were said once more
    assert told == {"checkpoint that cannot be read": 1}


# --- with a key ---------------------------------------------------------------------------------


def test_coordinators_with_one_key_take_over_from_each_other(model: SensorModel) -> None:
    living, plain = lived(model, KEY), lived(model)
    for system in (living, plain):
        system.revive()
        system.drive(LAST + 1)
    assert essence(living.beliefs[LAST + 1][-1]) == essence(plain.beliefs[LAST + 1][-1])
    assert living.particles() == plain.particles()
    assert living.refused == []
    assert counters(living) == counters(plain)


def test_a_coordinator_with_another_key_believes_nothing_of_it(model: SensorModel) -> None:
    living = lived(model, KEY)
    living.trust = living.trusting(b"o" * 32)
    living.revive()
    assert set(living.refused) >= {"malformed Checkpoint: not signed"}
    assert counters(living) == {}
    living.drive(LAST + 1)
    told = living.beliefs[LAST + 1][-1].hypotheses
    assert max(place.age_steps for place in told) < LAST, "all are found anew"


def test_a_forged_checkpoint_is_refused_and_the_true_one_used(model: SensorModel) -> None:
    """One that could be: another belief, in a higher term."""
    living = lived(model, KEY)
    before, last = living.beliefs[LAST][-1], last_of(living)
    state = from_bytes(last.state)
    one = replace(state.ensemble.clusters[0], log_probability=0.0)
    jobs = tuple(job for job in state.jobs if job.job_id == one.job_id)
    dictated = replace(
        state,
        jobs=jobs,
        ensemble=replace(
            state.ensemble,
            clusters=(one,),
            log_elsewhere=-math.inf,
            log_off_map=-math.inf,
            search=None,
        ),
    )
    forged = replace(last, term=last.term + 5, state=to_bytes(dictated))
    assert from_bytes(forged.state) == dictated, "it would be carried on from"
    publish(living, forged)
    living.revive()
    assert essence(living.beliefs[LAST][-1]) == essence(before)
    assert "malformed Checkpoint: not signed" in living.refused


def answering(living: Living, term: int) -> Coordinator:
    """The coordinator after a worker has told of a term."""
    coordinator = living.coordinator
    assert coordinator is not None
    forged = OrderAnswer(sender="w0", order=1, incarnation=1, jobs=(), term=term)
    living.answer_order("w0", forged)
    living.settle()
    return coordinator


def test_a_forged_term_in_an_answer_to_an_order_deposes_nobody(model: SensorModel) -> None:
    living = lived(model, KEY)
    assert answering(living, term=2).outranked_by is None
    assert living.refused == ["malformed OrderAnswer: not signed"]
    living.drive(LAST + 1)
    assert LAST + 1 in living.beliefs


def test_without_a_key_a_term_that_would_be_the_last_deposes_nobody_either(
    model: SensorModel,
) -> None:
    living = lived(model)
    assert answering(living, term=2**53 - 1).outranked_by is None
    assert living.refused == ["malformed OrderAnswer: term far ahead"]
    assert answering(living, term=2).outranked_by == 2, "as today: everybody is trusted"


def test_a_refused_order_tells_of_the_higher_term_with_its_proof(model: SensorModel) -> None:
    """A coordinator that slept is deposed by the workers, which hand back the other's proof."""
    living = lived(model, KEY)
    old = living.coordinator
    assert old is not None
    living.revive()
    living.coordinator = old
    living.kill_worker("w0")  # it gives the jobs to others, who refuse
    assert old.outranked_by == 2
    assert living.refused == []
