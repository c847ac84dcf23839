"""How soon a process that died is started again."""


class Backoff:
    """Restart at once, then wait longer each time, until one has lived long enough.

    Args:
        first_s: the wait after the first death [s].
        longest_s: no wait is longer [s].
        settled_s: who lived so long starts from `first_s` again [s].
    """

    def __init__(
        self, *, first_s: float = 0.1, longest_s: float = 10.0, settled_s: float = 10.0
    ) -> None:
        self._first_s, self._longest_s, self._settled_s = first_s, longest_s, settled_s
        self._next_s = first_s

    def after_death(self, lived_s: float) -> float:
        """Return how long to wait before the next start [s].

        Args:
            lived_s: how long the process had run [s].
        """
        if lived_s >= self._settled_s:
            self._next_s = self._first_s
        wait_s = self._next_s
        self._next_s = min(2.0 * wait_s, self._longest_s)
        return wait_s
