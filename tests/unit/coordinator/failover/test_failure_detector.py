from coordinator.instructions import FetchScans, SendOrder
from coordinator.replica import LISTEN_NS, PAUSE_NS, SETTLE_NS, FailureDetector, SelfFencing
from protocol.work import WorkOrder

SECOND = 1_000_000_000


def order() -> WorkOrder:
    return WorkOrder(
        sender="coordinator",
        order=1,
        map_digest="map",
        filter_settings={},
        snapshot_every_steps=10,
        keep=(),
        begin=(),
    )


def test_a_token_that_vanishes_while_the_link_stands_is_a_death() -> None:
    detector = FailureDetector(2.0, 0)
    detector.sign_of_life(SECOND)
    detector.token_vanished(SECOND)
    assert not detector.is_over(SECOND + SETTLE_NS - 1)
    assert detector.is_over(SECOND + SETTLE_NS)


def test_a_token_that_vanishes_with_the_own_link_is_none() -> None:
    detector = FailureDetector(2.0, 0)
    detector.token_vanished(SECOND)
    detector.link(False, SECOND + 1)
    assert not detector.is_over(100 * SECOND)
    detector.link(True, 100 * SECOND)
    assert not detector.is_over(102 * SECOND - 1), "the coordinator needs time to come back too"
    assert detector.is_over(102 * SECOND)


def test_a_coordinator_that_speaks_is_alive_whatever_its_token_does() -> None:
    detector = FailureDetector(2.0, 0)
    detector.token_vanished(SECOND)
    detector.sign_of_life(SECOND + 1)
    assert not detector.is_over(SECOND + SETTLE_NS)


def test_silence_is_a_death_too() -> None:
    detector = FailureDetector(2.0, 0)
    detector.sign_of_life(SECOND)
    assert not detector.is_over(3 * SECOND - 1)
    assert detector.is_over(3 * SECOND)


def test_after_a_pause_nothing_is_done_until_it_is_certain_who_acts() -> None:
    fencing = SelfFencing(0)
    fencing.turn(PAUSE_NS)
    first, second = SendOrder("w", order()), SendOrder("v", order())
    assert fencing.cleared([first], PAUSE_NS) == [first]
    woken_ns = 3 * PAUSE_NS
    fencing.turn(woken_ns)
    assert fencing.cleared([first], woken_ns) == []
    assert fencing.is_listening(woken_ns + LISTEN_NS - 1)
    fencing.turn(woken_ns + PAUSE_NS)
    assert fencing.cleared([second], woken_ns + LISTEN_NS) == [first, second]


def test_who_is_stopped_in_the_middle_of_a_turn_does_nothing_of_what_it_came_to() -> None:
    fencing = SelfFencing(0)
    fencing.turn(SECOND)
    woken_ns = SECOND + PAUSE_NS + 1
    assert fencing.cleared([SendOrder("w", order())], woken_ns) == []
    assert fencing.is_listening(woken_ns)


def test_lost_scans_are_asked_for_even_while_it_listens() -> None:
    """The wait for them ends with the follower's timeout; a query is harmless."""
    fencing = SelfFencing(0)
    fencing.listen(0)
    first, fetch = SendOrder("w", order()), FetchScans(1, 2)
    assert fencing.cleared([first, fetch], 1) == [fetch]
    fencing.turn(PAUSE_NS)
    assert fencing.cleared([], LISTEN_NS) == [first]
