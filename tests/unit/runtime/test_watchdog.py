import socket
from contextlib import closing

import pytest

from clustermcl.runtime.watchdog import SOCKET_VARIABLE, Listener


def first_hang(signs: set[int], asked: range | list[int], hung_after_s: float = 10.0) -> int | None:
    with (
        closing(Listener(hung_after_s)) as listener,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as child,
    ):
        child.connect(listener.variables()[SOCKET_VARIABLE].replace("@", "\0"))
        for now_s in asked:
            if now_s in signs:
                child.send(b"WATCHDOG=1")
            if listener.is_hung(now_s):
                return now_s
        return None


@pytest.mark.parametrize(("signs", "asked", "hangs_at"), [
    ({3, 5}, range(60), 16),
    (set(), range(60), None),
    (set(range(0, 60, 10)), range(60), None),
    ({5}, [*range(8), *range(100, 105)], None),
    ({5}, [*range(8), *range(100, 160)], 111),
], ids=[
    "silence after a sign", "no sign yet", "signs all along", "the asking process was stopped too",
    "then the silence counts again",
])  # fmt: skip
def test_a_process_hangs_when_its_signs_of_life_end(
    signs: set[int], asked: range | list[int], hangs_at: int | None
) -> None:
    assert first_hang(signs, asked) == hangs_at
