from coordinator.doubt import LISTEN_NS, PAUSE_NS, Doubt
from coordinator.instructions import FetchScans, SendOrder
from coordinator.standby import SETTLE_NS, Vigil
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
    vigil = Vigil(2.0, 0)
    vigil.sign_of_life(SECOND)
    vigil.token_vanished(SECOND)
    assert not vigil.is_over(SECOND + SETTLE_NS - 1)
    assert vigil.is_over(SECOND + SETTLE_NS)


def test_a_token_that_vanishes_with_the_own_link_is_none() -> None:
    vigil = Vigil(2.0, 0)
    vigil.token_vanished(SECOND)
    vigil.link(False, SECOND + 1)
    assert not vigil.is_over(100 * SECOND)
    vigil.link(True, 100 * SECOND)
    assert not vigil.is_over(102 * SECOND - 1), "the coordinator needs time to come back too"
    assert vigil.is_over(102 * SECOND)


def test_a_coordinator_that_speaks_is_alive_whatever_its_token_does() -> None:
    vigil = Vigil(2.0, 0)
    vigil.token_vanished(SECOND)
    vigil.sign_of_life(SECOND + 1)
    assert not vigil.is_over(SECOND + SETTLE_NS)


def test_silence_is_a_death_too() -> None:
    vigil = Vigil(2.0, 0)
    vigil.sign_of_life(SECOND)
    assert not vigil.is_over(3 * SECOND - 1)
    assert vigil.is_over(3 * SECOND)


def test_after_a_pause_nothing_is_done_until_it_is_certain_who_acts() -> None:
    doubt = Doubt(0)
    doubt.turn(PAUSE_NS)
    first, second = SendOrder("w", order()), SendOrder("v", order())
    assert doubt.cleared([first], PAUSE_NS) == [first]
    woken_ns = 3 * PAUSE_NS
    doubt.turn(woken_ns)
    assert doubt.cleared([first], woken_ns) == []
    assert doubt.lasts(woken_ns + LISTEN_NS - 1)
    assert doubt.cleared([second], woken_ns + LISTEN_NS) == [first, second]


def test_lost_scans_are_asked_for_even_in_doubt() -> None:
    """They are waited for no longer than the doubt lasts, and a question harms nobody."""
    doubt = Doubt(0)
    doubt.arise(0)
    first, fetch = SendOrder("w", order()), FetchScans(1, 2)
    assert doubt.cleared([first, fetch], 1) == [fetch]
    assert doubt.cleared([], LISTEN_NS) == [first]
