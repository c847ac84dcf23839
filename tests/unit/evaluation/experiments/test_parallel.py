from evaluation.experiments.parallel import Advanced, Done, Failed, in_parallel
from process_runtime.stop import StopFlag
from tests.unit.evaluation.experiments.work_pieces import work


def test_pieces_that_fail_or_kill_their_process_cost_only_themselves() -> None:
    pieces = ["a", "fail", "die", "refuse", "b"]
    events = list(in_parallel(work, pieces, 2, StopFlag()))
    done = {event.piece: event.result for event in events if isinstance(event, Done)}
    failed = {event.piece: event.problem for event in events if isinstance(event, Failed)}
    assert done == {0: "A", 4: "B"}
    assert failed[1].startswith("ZeroDivisionError in work_pieces.py:")
    assert failed[1].endswith(": nothing to divide by")
    assert failed[2] == "its process ended with 7"
    assert failed[3] == "two lines"
    assert [event for event in events if isinstance(event, Advanced)] == [
        Advanced(0, 2),
        Advanced(4, 2),
    ]


def test_a_stop_ends_what_hangs_and_keeps_what_is_done() -> None:
    stop, events = StopFlag(), []
    for event in in_parallel(work, ["a", "hang", "b"], 1, stop):
        events.append(event)
        if event == Advanced(1, 1):
            stop.set()
    assert [event for event in events if isinstance(event, Done)] == [Done(0, "A")]


def test_signals_to_the_whole_group_are_left_to_the_one_that_decides() -> None:
    events = list(in_parallel(work, ["signalled"], 1, StopFlag()))
    assert events[-1] == Done(0, "SIGNALLED")


def test_of_nothing_nothing_comes() -> None:
    assert list(in_parallel(work, [], 4, StopFlag())) == []
