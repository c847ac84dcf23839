from process_runtime.stop import StopFlag
from process_runtime.supervisor import run_forked


def test_a_process_stopped_while_it_compiled_forks_nothing() -> None:
    """The signal has started a watching thread; a later fork would be refused as a bug."""
    stop = StopFlag()
    stop.set()
    forked: list[int] = []
    run_forked(3, lambda index, _stop: forked.append(index), stop, name="worker")
    assert forked == []
