from clustermcl.belief.search_course import KEPT_STEPS, SearchCourse


def test_where_clusters_were_is_known_of_the_last_steps_only() -> None:
    course = SearchCourse()
    for step in range(KEPT_STEPS + 9):
        course.note_means(step, ())
    assert list(course.means) == list(range(9, KEPT_STEPS + 9))
