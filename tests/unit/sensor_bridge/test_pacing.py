from sensor_bridge.pacing import RESEND_AFTER_NS, Pacing


def test_the_next_step_waits_for_the_belief_of_the_last() -> None:
    pacing = Pacing(0.0)
    pacing.step_sent(5, 0)
    pacing.believed(4, term=1)
    assert pacing.waits
    pacing.believed(5, term=1)
    assert not pacing.waits


def test_a_belief_of_a_coordinator_that_was_taken_over_from_counts_nothing() -> None:
    pacing = Pacing(0.0)
    pacing.step_sent(5, 0)
    pacing.believed(4, term=2)
    pacing.believed(5, term=1)
    assert pacing.waits


def test_a_step_whose_belief_does_not_come_goes_out_again() -> None:
    pacing = Pacing(0.0)
    pacing.step_sent(5, 0)
    assert not pacing.resend_due(RESEND_AFTER_NS - 1)
    assert pacing.resend_due(RESEND_AFTER_NS)
    assert not pacing.resend_due(RESEND_AFTER_NS + 1)
