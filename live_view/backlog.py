"""What one browser has still to be sent: the newest of each topic, however slow it is."""

from collections.abc import Mapping

MESSAGES_AHEAD = 6
"""Under way to a page that keeps up: it says that it has drawn once for several."""


class Backlog:
    """Holds back what comes while the browser has not yet drawn the last frames.

    All frames are states: a newer one of the same topic replaces an older one that waits. So a
    slow browser skips pictures, and takes no more memory than one picture.

    Args:
        frames: what it is sent first: topic to encoded frame.
    """

    def __init__(self, frames: Mapping[str, bytes]) -> None:
        self._owed = dict(frames)
        self._under_way, self._ahead = 0, MESSAGES_AHEAD

    def offer(self, frames: Mapping[str, bytes]) -> None:
        """Newer frames."""
        self._owed.update(frames)

    def on_drawn(self, count: int, *, slow: bool) -> None:
        """The browser has drawn so many more messages.

        Args:
            count: since it said so last.
            slow: drawing takes long, so each message waits until the last one is drawn.
        """
        self._under_way = max(self._under_way - count, 0)
        self._ahead = 1 if slow else MESSAGES_AHEAD

    def take(self) -> list[bytes]:
        """What to send now, in the order in which the topics came; nothing while it draws."""
        if self._under_way >= self._ahead or not self._owed:
            return []
        frames = list(self._owed.values())
        self._owed.clear()
        self._under_way += 1
        return frames
