import pytest

from clustermcl.belief.search_course import KEPT_STEPS, SearchCourse
from clustermcl.belief.search_pool import SearchPool


def test_later_explanations_take_a_share_of_the_remaining_weight() -> None:
    search = SearchPool(("s0.0",), 1)
    shares = [search.newly_explained(share) for share in (0.5, 0.8, 0.6, 1.0, 1.0)]
    assert shares == pytest.approx([0.5, 0.6, 0.0, 1.0, 0.0]), "of 1, 0.5, 0.2, 0.2 and nothing"


def test_where_clusters_were_is_known_of_the_last_steps_only() -> None:
    course = SearchCourse()
    for step in range(KEPT_STEPS + 9):
        course.note_means(step, ())
    assert list(course.means) == list(range(9, KEPT_STEPS + 9))
