"""A link that came back and through which nothing comes."""

from process_runtime.settings import RobotSettings, ZenohSettings
from process_runtime.stop import StopFlag
from protocol.errors import UnreachableError
from zenoh_link.session import open_session
from zenoh_link.wire import Link, Token, is_alive

STALE_NS = 10_000_000_000
"""Everybody who is not alone hears something in this time."""
STALE = "the link came back and nothing comes through it: opening another"
_LOOK_S = 1.0


class StaleSessionDetector:
    """Suspects a link through which nothing has come since it came back.

    A session declares everything anew when its link comes back. Once in an hour of chaos that
    failed: what the process put went out, and nothing came in for four minutes, until the link
    was lost again. Only another session helps, and shows whether anybody is there to be heard.
    """

    def __init__(self) -> None:
        self._lost = False
        self._back_ns: int | None = None

    @property
    def is_armed(self) -> bool:
        """Whether the link came back, and nothing has come through it since."""
        return self._back_ns is not None

    def on_event(self, event: object, now_ns: int) -> None:
        """Something has happened: the link came or went, or something came through it.

        Its first coming is no coming back; a token vanishes for it when the link is lost, too.
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
        """Whether to look who is there; True again only after as long."""
        if self._back_ns is None or now_ns - self._back_ns < STALE_NS:
            return False
        self._back_ns = now_ns
        return True


def is_there(settings: ZenohSettings, robot: RobotSettings, stop: StopFlag, key: str) -> bool:
    """Whether a session of its own sees a liveliness token; False where none can be opened."""
    try:
        with open_session(settings, robot, stop, wait_s=_LOOK_S) as session:
            return is_alive(session, key, _LOOK_S)
    except UnreachableError:
        return False
