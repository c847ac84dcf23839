import math

import pytest

from clustermcl.belief.search_course import KEPT_STEPS, SearchEvidence


def test_the_weight_of_a_search_is_that_of_elsewhere_times_the_likelihood_ratio() -> None:
    evidence = SearchEvidence(math.log(0.2))
    for step, reported in ((4, -1.0), (5, -2.5), (6, -0.5)):
        evidence.gather(step, reported)
    assert evidence.log_weight(6, -3.0) == pytest.approx(math.log(0.2) - 3.0 + 4.0)
    assert evidence.log_weight(5, -3.0) == pytest.approx(math.log(0.2) - 3.0 + 3.5)


def test_an_unknown_step_adds_no_weight() -> None:
    evidence = SearchEvidence()
    assert evidence.log_weight(0, 0.0) == -math.inf
    for step in range(KEPT_STEPS + 1):
        evidence.gather(step, -1.0)
    assert evidence.log_weight(0, 0.0) == -math.inf, "too long ago"
    assert evidence.log_weight(1, 0.0) == pytest.approx(2.0), "all before it still counts"
    assert evidence.log_weight(KEPT_STEPS, 0.0) == pytest.approx(KEPT_STEPS + 1.0)


def test_a_search_has_no_weight_if_elsewhere_was_impossible() -> None:
    evidence = SearchEvidence(-math.inf)
    evidence.gather(1, -1.0)
    assert evidence.log_weight(1, 5.0) == -math.inf


def test_later_explanations_take_a_share_of_the_remaining_weight() -> None:
    evidence = SearchEvidence()
    shares = [evidence.newly_explained(share) for share in (0.5, 0.8, 0.6, 1.0, 1.0)]
    assert shares == pytest.approx([0.5, 0.6, 0.0, 1.0, 0.0]), "of 1, 0.5, 0.2, 0.2 and nothing"
