from clustermcl.worker.search_queue import LONGEST_NS, SearchPause

MS = 1_000_000


def paused_for(step: int, *, founded: bool = True) -> SearchPause:
    """The step before is decided, this one's scan comes at 10 ms."""
    pause = SearchPause()
    pause.on_checkpoint(step - 1, founded=founded)
    pause.on_scan(step, 10 * MS)
    return pause


def test_searches_wait_until_the_step_is_decided() -> None:
    pause = paused_for(7)
    assert pause.left_ns(12 * MS) == LONGEST_NS - 2 * MS
    pause.on_checkpoint(7, founded=True)
    assert pause.left_ns(12 * MS) == 0


def test_an_undecided_step_pauses_searches_for_a_limited_time() -> None:
    pause = paused_for(7)
    assert pause.left_ns(10 * MS + LONGEST_NS) == 0
    pause.on_scan(8, 500 * MS)
    pause.on_checkpoint(7, founded=True)
    assert pause.left_ns(500 * MS) == 0, "a belief that lags behind may wait for the search"
    pause.on_checkpoint(8, founded=True)
    pause.on_scan(9, 600 * MS)
    assert pause.left_ns(600 * MS) == LONGEST_NS


def test_the_first_search_is_not_paused() -> None:
    assert paused_for(0, founded=False).left_ns(12 * MS) == 0
    assert SearchPause().left_ns(0) == 0


def test_a_restart_of_steps_ends_the_pause() -> None:
    pause = paused_for(700)
    pause.on_scan(3, 20 * MS)
    assert pause.left_ns(20 * MS) == 0
