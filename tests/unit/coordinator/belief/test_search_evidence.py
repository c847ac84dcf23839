import pytest

from clustermcl.belief.search_course import SearchEvidence


def test_later_explanations_take_a_share_of_the_remaining_weight() -> None:
    evidence = SearchEvidence()
    shares = [evidence.newly_explained(share) for share in (0.5, 0.8, 0.6, 1.0, 1.0)]
    assert shares == pytest.approx([0.5, 0.6, 0.0, 1.0, 0.0]), "of 1, 0.5, 0.2, 0.2 and nothing"
