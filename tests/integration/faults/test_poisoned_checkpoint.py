"""docs/failures.md: an impossible checkpoint is ignored, and the belief is kept."""

import msgspec
from msgspec.structs import replace

from clustermcl.stack import COORDINATOR
from coordinator.checkpoint import state_in
from protocol import keys
from protocol.codec import decode, encode
from protocol.work import Checkpoint
from tests.integration.faults.live_robot import with_live_robot
from tests.integration.faults.system import System
from tests.integration.faults.test_coordinator_dies import (
    alone_of,
    assert_same,
)
from tests.integration.waiting import wait_until
from tests.unit.coordinator.test_poisoned_checkpoints import nan_covariance


def heard(tested: System) -> Checkpoint:
    """Return a checkpoint of the acting coordinator, with clusters that are tracked."""
    found: list[Checkpoint] = []
    subscriber = tested.session.declare_subscriber(
        keys.CHECKPOINT,
        lambda sample: found.append(decode(sample.payload.to_bytes(), Checkpoint)),
    )
    wait_until(lambda: found and len(state_in(found[-1]).ensemble.clusters))
    subscriber.undeclare()
    return found[-1]


def poisoned(checkpoint: Checkpoint) -> Checkpoint:
    """Return the same with a NaN in it, and of a rank above all present ones."""
    tree = msgspec.msgpack.decode(checkpoint.state)
    nan_covariance(tree)
    state = msgspec.msgpack.encode(tree)
    return replace(checkpoint, sender="a stranger", serial=2**50, state=state)


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
