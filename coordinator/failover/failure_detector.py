"""Whether the coordinator that this process stands by for is dead."""

SETTLE_NS = 100_000_000
"""Zenoh reports tokens as vanished up to some milliseconds before the link they came by."""


class FailureDetector:
    """Told of signs of life; says when there are none any more.

    A token that vanishes while the own link stands is a death that the router has seen. Without
    that, silence must last: a link that was lost, here or there, comes back first.
    """

    def __init__(self, take_over_after_s: float, now_ns: int) -> None:
        self._silence_ns = int(take_over_after_s * 1e9)
        self._linked = True
        self._last_sign_ns = now_ns
        self._died_ns: int | None = None

    def sign_of_life(self, now_ns: int) -> None:
        """The coordinator speaks, or its token is there."""
        self._last_sign_ns, self._died_ns = now_ns, None

    def token_vanished(self, now_ns: int) -> None:
        """The coordinator's token is gone, or this process's own link."""
        self._died_ns = now_ns

    def link(self, up: bool, now_ns: int) -> None:
        """The own link came up or was lost: nothing that was heard about it counts."""
        self._linked = up
        self._last_sign_ns, self._died_ns = now_ns, None

    def is_over(self, now_ns: int) -> bool:
        """Whether to take over."""
        if not self._linked:
            return False
        if self._died_ns is not None and now_ns - self._died_ns >= SETTLE_NS:
            return True
        return now_ns - self._last_sign_ns >= self._silence_ns
