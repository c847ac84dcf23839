"""The delay before a dead process is restarted."""


class Backoff:
    """Exponential back-off, reset by a process that has run for `settled_s`.

    Args:
        first_s: the first delay [s].
        longest_s: the longest delay [s].
        settled_s: a process that ran at least this time resets the delay to `first_s` [s].
    """

    def __init__(
        self, *, first_s: float = 0.1, longest_s: float = 10.0, settled_s: float = 10.0
    ) -> None:
        self._first_s, self._longest_s, self._settled_s = first_s, longest_s, settled_s
        self._next_s = first_s

    def after_death(self, lived_s: float) -> float:
        """Return the delay before the next start [s], for a process that ran `lived_s`."""
        if lived_s >= self._settled_s:
            self._next_s = self._first_s
        wait_s = self._next_s
        self._next_s = min(2.0 * wait_s, self._longest_s)
        return wait_s
