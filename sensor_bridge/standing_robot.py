"""When a robot that stands is to make a step: while nothing is known of where it is.

A robot that is switched on, told to search everywhere, or given another map should not have to
drive before it is told where it may be.
"""

EVERY_NS = 200_000_000


class StandingRobot:
    """Told of steps and beliefs; says whether another step of a standing robot is wanted.

    A map that has come while the robot stands needs several steps: the coordinator follows none
    for a single scan.
    """

    def __init__(self) -> None:
        self._step, self._sent_ns = -1, 0
        self._believed_step, self._searching, self._term = -1, False, 0
        self._new_map_step: int | None = None

    def step_sent(self, step: int, now_ns: int) -> None:
        """A step went out."""
        self._step, self._sent_ns = step, now_ns

    def believed(self, step: int, term: int, *, searching: bool) -> None:
        """A belief is out; one of a lower term than was heard before counts nothing.

        Args:
            step: its own.
            term: its coordinator's.
            searching: no place is tracked.
        """
        if term < self._term:
            return
        self._believed_step, self._term, self._searching = step, term, searching
        if self._new_map_step is not None and step >= self._new_map_step:
            self._new_map_step = None

    def new_map(self) -> None:
        """Steps from the next one on are of another map."""
        self._new_map_step = self._step + 1

    def wants_step(self, now_ns: int) -> bool:
        """Whether the next scan should become a step, even if the robot stands."""
        unknown = self._searching and self._believed_step >= self._step
        wanted = unknown or self._new_map_step is not None
        return wanted and now_ns - self._sent_ns >= EVERY_NS
