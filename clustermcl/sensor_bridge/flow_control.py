"""Flow control: makes, repeats or delays a step, by the numbers of sent and decided steps."""

from collections import deque

from clustermcl.sensor_bridge.step_maker import StepMaker

MAX_UNDECIDED = 4
"""Number of sent but undecided steps at which no scan becomes a step."""
OUTAGE_NS = 1_000_000_000
"""After this time without a belief no coordinator decides [ns]. Steps continue, for the next
coordinator and for the workers."""
RESEND_AFTER_NS = 1_000_000_000
STANDING_STEP_NS = 200_000_000
"""Shortest interval of steps of a standing robot [ns]."""


class FlowControl:
    """Follows which steps are decided.

    In lockstep (rate 0) each step waits for the belief of the one before. A live robot gets
    back-pressure: an overloaded system makes fewer steps rather than dropping some later.
    """

    def __init__(self, rate: float) -> None:
        self.lockstep, self._rate = rate == 0.0, rate
        self._first: tuple[int, int] | None = None
        self._undecided: deque[int] = deque()
        self._step, self._sent_ns = -1, 0
        self._decided_step = -1
        self._decided_ns: int | None = None
        self._term, self._searching = 0, False
        self._new_map_step: int | None = None

    def on_sent(self, step: int, now_ns: int) -> None:
        self._undecided.append(step)
        self._step, self._sent_ns = step, now_ns

    def on_belief(self, step: int, term: int, now_ns: int, *, searching: bool) -> None:
        """Note that a step is decided at a monotonic time; ignore beliefs of older terms.

        `searching`: no place is tracked.
        """
        if term < self._term:
            return
        self._term, self._searching = term, searching
        self._decided_step, self._decided_ns = step, now_ns
        while self._undecided and self._undecided[0] <= step:
            self._undecided.popleft()
        if self._new_map_step is not None and step >= self._new_map_step:
            self._new_map_step = None

    def on_new_map(self) -> None:
        """Note that steps from the next one on belong to another map."""
        self._new_map_step = self._step + 1

    def set_gate(self, maker: StepMaker, now_ns: int, *, is_live_scan: bool) -> None:
        """Hold the gate, or open it for a standing robot, before `maker` takes a reading."""
        if is_live_scan and maker.stands and self.wants_standing_step(now_ns):
            maker.gate.open_next()
        maker.gate.is_held = self.is_full(now_ns)

    def is_full(self, now_ns: int) -> bool:
        """Return whether too many steps are undecided while decisions still arrive."""
        return (
            not self.lockstep
            and len(self._undecided) >= MAX_UNDECIDED
            and self._decided_ns is not None
            and now_ns - self._decided_ns < OUTAGE_NS
        )

    def wants_standing_step(self, now_ns: int) -> bool:
        """Return whether a scan of a standing robot should become a step.

        A robot should not have to drive before it is localized: after it is switched on, after a
        command to search, or in a new map. The coordinator changes maps only after several scans.
        """
        unknown = self._searching and self._decided_step >= self._step
        wanted = unknown or self._new_map_step is not None
        return wanted and now_ns - self._sent_ns >= STANDING_STEP_NS

    @property
    def waits(self) -> bool:
        """Whether the next step waits for a belief."""
        return self.lockstep and bool(self._undecided)

    def is_resend_due(self, now_ns: int) -> bool:
        """Return whether to repeat the last step, because it or its belief may be lost."""
        if not self.waits or now_ns - self._sent_ns < RESEND_AFTER_NS:
            return False
        self._sent_ns = now_ns
        return True

    def due_in_s(self, stamp_ns: int, now_ns: int) -> float:
        """Return when a reading of a source is due [s]; 0 if its stamp steps back."""
        if self.lockstep:
            return 0.0
        if self._first is None:
            self._first = (stamp_ns, now_ns)
        first_stamp_ns, first_ns = self._first
        due_ns = first_ns + (stamp_ns - first_stamp_ns) / self._rate
        return max((due_ns - now_ns) / 1e9, 0.0)
