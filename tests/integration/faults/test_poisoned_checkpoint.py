"""docs/failures.md: a checkpoint that cannot be is left out, and the belief is kept."""

import math

from msgspec.structs import replace

from clustermcl.stack import COORDINATOR
from coordinator.checkpoint import from_bytes, to_bytes
from protocol import keys
from protocol.answers import Belief
from protocol.codec import decode, encode
from protocol.work import Checkpoint
from tests.integration.faults.live_robot import with_live_robot
from tests.integration.faults.system import System
from tests.integration.faults.test_coordinator_dies import (
    alone_of,
    assert_same,
)
from tests.integration.waiting import wait_until


def heard(tested: System) -> Checkpoint:
    """A checkpoint of the acting coordinator, of clusters that are tracked."""
    found: list[Checkpoint] = []
    subscriber = tested.session.declare_subscriber(
        keys.CHECKPOINT,
        lambda sample: found.append(decode(sample.payload.to_bytes(), Checkpoint)),
    )
    wait_until(lambda: found and from_bytes(found[-1].state).ensemble.clusters)
    subscriber.undeclare()
    return found[-1]


def poisoned(checkpoint: Checkpoint) -> Checkpoint:
    """The same with a NaN in it, and of a higher rank than all that there are."""
    state = from_bytes(checkpoint.state)
    first, *rest = state.ensemble.clusters
    first = replace(first, covariance=(math.nan,) * 9)
    ensemble = replace(state.ensemble, clusters=(first, *rest))
    return replace(
        checkpoint,
        sender="a stranger",
        serial=2**50,
        state=to_bytes(replace(state, ensemble=ensemble)),
    )


def test_a_poisoned_checkpoint_ends_no_follower_and_no_belief() -> None:
    """The last checkpoint that a follower received is useless; it continues from its state
    file."""
    with with_live_robot() as (tested, _robot):
        standby = tested.start(COORDINATOR, "--standby")
        standby.wait_for("standing by")
        tested.wait_until_it_tracks()
        tested.session.put(keys.CHECKPOINT, encode(poisoned(heard(tested))))
        terms = {belief.term for belief in tested.beliefs}
        tested.hurt(COORDINATOR)
        wait_until(lambda: {belief.term for belief in tested.beliefs} > terms)
        tested.wait_for_steps(10)
        assert "Traceback" not in standby.err
        with tested.client as client:
            status = client.status()
        assert status.counters["checkpoint that cannot be read"] >= 1
        assert status.steps_lost == 0
        assert_same(list(tested.beliefs), alone_of(tested))


def test_the_highest_possible_term_is_refused_by_all() -> None:
    with with_live_robot() as (tested, _robot):
        tested.wait_until_it_tracks()
        last = replace(heard(tested), term=2**53 - 1)
        tested.session.put(keys.CHECKPOINT, encode(last))
        wait_until(lambda: "term far ahead" in tested.log(COORDINATOR))
        tested.hurt(COORDINATOR)
        wait_until(lambda: any(ended.name == COORDINATOR for ended in tested.stack.ended()))
        tested.mend()
        terms = {belief.term for belief in tested.beliefs}
        wait_until(lambda: {belief.term for belief in tested.beliefs} > terms)
        tested.wait_for_steps(10)
        assert max(belief.term for belief in tested.beliefs) < 2**52
        believed: list[Belief] = list(tested.beliefs)
        assert_same(believed, alone_of(tested))
