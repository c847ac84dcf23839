from msgspec.structs import replace

from clustermcl.coordinator.checkpoint import state_in, to_bytes
from clustermcl.coordinator.replica import NewestState
from clustermcl.protocol.work import Checkpoint
from tests.unit.coordinator.reports import checkpoint
from tests.unit.coordinator.test_coordinator import checkpoint_at

SECOND = 1_000_000_000
KNOWN = state_in(checkpoint_at((1.0, 2.0, 0.5)))


def published(
    *, age_s: float, stamp_s: int = 100, live: bool = True, known_age: bool = True, serial: int = 1
) -> Checkpoint:
    """Of a coordinator that tracks a robot; its scan's stamp is 100 s."""
    applied = replace(KNOWN.collector.applied, stamp_ns=stamp_s * SECOND, live=live)
    collector = replace(KNOWN.collector, applied=applied)
    state = replace(KNOWN, collector=collector, age_s=age_s, age_known=known_age)
    return checkpoint(1, serial, step=applied.step, state=to_bytes(state))


def test_the_usual_delay_is_the_least_delay_of_the_received_states() -> None:
    newest = NewestState()
    newest.on_state(published(age_s=0.25), now_ns=3 * SECOND)
    newest.on_state(
        published(age_s=0.25, stamp_s=101, serial=2), now_ns=6 * SECOND
    )  # held up for two seconds
    assert newest.usual_delay_ns == 3 * SECOND - SECOND // 4 - 100 * SECOND


def test_a_repeated_state_is_a_sign_of_life_and_does_not_change_the_usual_delay() -> None:
    newest, given = NewestState(), published(age_s=0.25)
    newest.on_state(given, now_ns=3 * SECOND)
    for after_s in range(60):  # the robot stands
        assert newest.on_state(given, now_ns=(3 + after_s) * SECOND)
    assert newest.usual_delay_ns == 3 * SECOND - SECOND // 4 - 100 * SECOND


def test_states_without_a_known_age_do_not_change_the_usual_delay() -> None:
    newest = NewestState()
    for state in (
        published(age_s=0.25, live=False),
        published(age_s=0.25, known_age=False, serial=2),
        published(age_s=float("nan"), serial=3),
        replace(published(age_s=0.25, serial=4), state=b"no state"),
    ):
        assert newest.on_state(state, now_ns=3 * SECOND)
        assert newest.checkpoint is state
    assert newest.usual_delay_ns is None
