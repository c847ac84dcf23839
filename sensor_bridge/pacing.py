"""When the next reading is due: by its own clock, at a rate, or as fast as workers follow."""

RESEND_AFTER_NS = 1_000_000_000


class Pacing:
    """Told what was sent and believed, answers how long to wait."""

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._first: tuple[int, int] | None = None
        self._awaited: int | None = None
        self._sent_ns = 0
        self._term = 0

    @property
    def paced(self) -> bool:
        """Whether the next step waits for the belief of the last one."""
        return self._rate == 0.0

    def step_sent(self, step: int, now_ns: int) -> None:
        """A step went out."""
        if self.paced:
            self._awaited, self._sent_ns = step, now_ns

    def believed(self, step: int, term: int) -> None:
        """The belief of a step is out; one of a lower term than was heard before counts nothing."""
        if term < self._term:
            return
        self._term = term
        if self._awaited is not None and step >= self._awaited:
            self._awaited = None

    @property
    def waits(self) -> bool:
        """Whether a belief is waited for."""
        return self._awaited is not None

    def resend_due(self, now_ns: int) -> bool:
        """Whether the last step should go out again: it, or its belief, may have been lost."""
        if self._awaited is None or now_ns - self._sent_ns < RESEND_AFTER_NS:
            return False
        self._sent_ns = now_ns
        return True

    def due_in_s(self, stamp_ns: int, now_ns: int) -> float:
        """How long until a reading of that stamp is due; stamps that step back are due at once."""
        if self.paced:
            return 0.0
        if self._first is None:
            self._first = (stamp_ns, now_ns)
        first_stamp_ns, first_ns = self._first
        due_ns = first_ns + (stamp_ns - first_stamp_ns) / self._rate
        return max((due_ns - now_ns) / 1e9, 0.0)
