from protocol.job_events import Ended, JobEvents, NumberedEvent
from soak_test.belief_checks import ClusterChanges, Probabilities
from soak_test.end_causes import EndCauses
from tests.unit.soak_test.hear import at, belief, place


def test_probabilities_must_sum_to_one() -> None:
    check = Probabilities()
    check.on_belief(at(1.0), belief(1, place(0, 0.25), place(1, 0.75)))
    check.on_belief(at(2.0), belief(2))  # still searching: no places, no sum
    assert check.verdict().kept is True
    check.on_belief(at(3.0), belief(3, place(0, 0.25), place(1, 0.75 + 2e-9)))
    assert check.verdict().kept is False


def test_a_probability_that_is_no_number_is_noticed() -> None:
    check = Probabilities()
    check.on_belief(at(1.0), belief(1, place(0, float("nan"))))
    assert check.verdict().kept is False


def test_clusters_that_come_and_go_are_named_with_the_reason() -> None:
    causes = EndCauses()
    check = ClusterChanges(causes)
    check.on_belief(at(1.0), belief(1, place(0, 0.5), place(1, 0.5, (3.0, 4.0, 0.0))))
    merged = Ended("c1", "merged", ("c0",), 0.5)
    event = NumberedEvent(number=7, step=2, stamp_ns=at(2.0), event=merged)
    causes.on_events(JobEvents(sender="coordinator", events=(event,)))
    check.on_belief(at(2.0), belief(2, place(0, 1.0)))
    check.on_belief(at(3.0), belief(3, place(0, 1.0)))
    assert [(change.at_ns, change.what) for change in check.changes] == [
        (at(1.0), "step 1; c0 has come; c1 has come"),
        (at(2.0), "step 2; c1 merged into c0 (0.5)"),
    ]


def test_a_cluster_that_goes_without_a_reason_is_named_as_such() -> None:
    check = ClusterChanges(EndCauses())
    check.on_belief(at(1.0), belief(1, place(0, 0.5), place(1, 0.5)))
    check.on_belief(at(2.0), belief(2, place(0, 1.0)))
    assert check.changes[-1].what == "step 2; c1 has gone, nobody said why"
