"""Detects a session that receives nothing after its link came back."""

from clustermcl.link.wire import Link, Token

STALE_NS = 3_000_000_000
"""A session with peers receives something within this time after its link returned [ns]."""
STALE = "nothing has arrived since the link returned: opening a new session"


class StaleSessionDetector:
    """Suspects a session that has received nothing since its link was restored.

    A session repeats its declarations when its link is restored. Once in an hour of fault injection
    that failed: the process could publish, but received nothing for four minutes, until the link
    was lost again. A second session shows whether peers exist; if so, it replaces the first.
    """

    def __init__(self) -> None:
        self._lost = False
        self._back_ns: int | None = None

    @property
    def is_armed(self) -> bool:
        """Whether the link came back and nothing was received since."""
        return self._back_ns is not None

    def on_event(self, event: object, now_ns: int) -> None:
        """Process any event of the loop.

        The first `Link(up=True)` is not a return. A token's disappearance proves nothing: Zenoh
        also reports it when the link is lost.
        """
        match event:
            case Link(up=True):
                self._back_ns = now_ns if self._lost else self._back_ns
                self._lost = False
            case Link(up=False):
                self._lost, self._back_ns = True, None
            case None | Token(alive=False):
                pass
            case _:
                self._back_ns = None

    def is_suspect(self, now_ns: int) -> bool:
        """Return whether to look for peers now, at most once in `STALE_NS`."""
        if self._back_ns is None or now_ns - self._back_ns < STALE_NS:
            return False
        self._back_ns = now_ns
        return True
