"""What one browser has still to be sent: the newest of each topic, however slow it is."""

from collections.abc import Mapping


class Backlog:
    """Holds back what comes while the browser has not yet drawn the last frames.

    All frames are states: a newer one of the same topic replaces an older one that waits. So a
    slow browser skips pictures, and takes no more memory than one picture.

    Args:
        frames: what it is sent first: topic to encoded frame.
    """

    def __init__(self, frames: Mapping[str, bytes]) -> None:
        self._owed = dict(frames)
        self._in_flight = False

    def offer(self, frames: Mapping[str, bytes]) -> None:
        """Newer frames."""
        self._owed.update(frames)

    def on_drawn(self) -> None:
        """The browser has drawn what it was sent last."""
        self._in_flight = False

    def take(self) -> list[bytes]:
        """What to send now, in the order in which the topics came; nothing while it draws."""
        if self._in_flight or not self._owed:
            return []
        frames = list(self._owed.values())
        self._owed.clear()
        self._in_flight = True
        return frames
