"""When a coordinator could be asked, and which faults excuse that something was missing."""

from dataclasses import dataclass

from soak_test.schedule import Kind
from soak_test.verdict import Break, Verdict

BACK_WITHIN_S = 5.0
"""After a fault a robot has a coordinator again within so long: starting a process takes 1-2 s."""
AFTER_FREEZE_S = 1.0
"""Who was frozen, or cut off, gets its link back within so long, and a coordinator then listens
for 0.6 s whether another has taken over."""
_UNREACHABLE = {
    Kind.COORDINATOR_KILLED, Kind.COORDINATOR_FROZEN, Kind.COORDINATOR_LINK_CUT,
    Kind.ROUTER_KILLED, Kind.ROUTER_FROZEN,
}  # fmt: skip
"""Faults after which nobody can ask the coordinator for a while."""
_CUT_OFF = {Kind.ROUTER_KILLED, Kind.ROUTER_FROZEN, Kind.SLOW_NETWORK}


@dataclass(frozen=True)
class DoneFault:
    """A fault that was done."""

    kind: Kind
    at_ns: int
    until_ns: int
    """The same for what is done in a moment."""
    robot: str
    """Whom it concerns; empty: all."""
    target: str
    """Whom it hit: names with spaces between."""
    how: str = ""
    """More of it, for people."""

    def concerns(self, robot: str) -> bool:
        """Whether a robot may notice."""
        return self.robot in ("", robot)


@dataclass
class _Absence:
    """The coordinator's token was not there."""

    begin_ns: int
    end_ns: int | None = None


class Availability:
    """Told of faults and of the coordinator's liveliness token, as one robot's observer sees it."""

    def __init__(self) -> None:
        self.faults: list[DoneFault] = []
        self._absences: list[_Absence] = []

    def fault(self, fault: DoneFault) -> None:
        """A fault was done."""
        self.faults.append(fault)

    def token(self, at_ns: int, *, alive: bool) -> None:
        """The coordinator's token came or went."""
        last = self._absences[-1] if self._absences else None
        if alive and last is not None and last.end_ns is None:
            last.end_ns = at_ns
        elif not alive and (last is None or last.end_ns is not None):
            self._absences.append(_Absence(at_ns))

    def reachable(self, begin_ns: int, end_ns: int) -> bool:
        """Whether a coordinator that keeps its promises could be reached all that time."""
        return not any(
            begin_ns <= until_ns and at_ns <= end_ns for at_ns, until_ns in self._windows()
        )

    def cut_off(self, begin_ns: int, end_ns: int) -> DoneFault | None:
        """The fault of the network that overlaps a time, if there is one."""
        return self._overlapping(_CUT_OFF, begin_ns, end_ns, AFTER_FREEZE_S + 1.0)

    def hit(self, kinds: set[Kind], begin_ns: int, end_ns: int, after_s: float) -> DoneFault | None:
        """The fault of some kinds whose consequences, `after_s` long, overlap a time."""
        return self._overlapping(kinds, begin_ns, end_ns, after_s)

    def verdict(self, now_ns: int) -> Verdict:
        """Whether the coordinator was always back in time, and never gone without a fault."""
        breaks, longest_s = [], 0.0
        for absence in self._absences:
            gone_s = ((absence.end_ns or now_ns) - absence.begin_ns) / 1e9
            longest_s = max(longest_s, gone_s)
            cause = self._overlapping(_UNREACHABLE, absence.begin_ns, absence.begin_ns, 3.0)
            if cause is None:
                breaks.append(Break(absence.begin_ns, f"gone for {gone_s:.1f} s without a fault"))
            elif gone_s > BACK_WITHIN_S + (cause.until_ns - cause.at_ns) / 1e9:
                breaks.append(Break(absence.begin_ns, f"gone for {gone_s:.1f} s"))
        return Verdict(
            promise="the robot has a coordinator again after a fault",
            target=f"within {BACK_WITHIN_S:g} s",
            measured=f"{len(self._absences)} times, longest {longest_s:.1f} s",
            kept=not breaks,
            breaks=tuple(breaks),
            figures={"absences": len(self._absences), "longest_s": longest_s},
        )

    def _windows(self) -> list[tuple[int, int]]:
        """When the coordinator need not be reachable; of a fault, no longer than promised."""
        windows = []
        for fault in self.faults:
            if fault.kind not in _UNREACHABLE:
                continue
            latest_ns = fault.until_ns + int(BACK_WITHIN_S * 1e9)
            end_ns = fault.until_ns
            for absence in self._absences:
                if absence.begin_ns <= latest_ns and (absence.end_ns or latest_ns) >= fault.at_ns:
                    end_ns = max(end_ns, min(absence.end_ns or latest_ns, latest_ns))
            windows.append((fault.at_ns, end_ns + int(AFTER_FREEZE_S * 1e9)))
        return windows

    def _overlapping(
        self, kinds: set[Kind], begin_ns: int, end_ns: int, after_s: float
    ) -> DoneFault | None:
        for fault in reversed(self.faults):
            until_ns = fault.until_ns + int(after_s * 1e9)
            if fault.kind in kinds and fault.at_ns <= end_ns and begin_ns <= until_ns:
                return fault
        return None
