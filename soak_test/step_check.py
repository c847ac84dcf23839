"""Promise: every step is believed once."""

from collections import OrderedDict
from dataclasses import dataclass

from protocol.answers import Belief
from soak_test.availability import Availability
from soak_test.schedule import Kind
from soak_test.verdict import KEPT_BREAKS, Break, Verdict

SAME_WITHIN = 1e-9
_RESTARTS = {Kind.COORDINATOR_KILLED, Kind.COORDINATOR_FROZEN, Kind.COORDINATOR_LINK_CUT}
_RESTART_S = 5.0
_NO_WORKERS = {Kind.ALL_WORKERS_KILLED}
_NO_WORKERS_S = 8.0
_REPLAY_S = 30.0
_KEPT_BELIEFS = 4096


@dataclass(frozen=True)
class _Gap:
    """Steps between two beliefs."""

    begin_ns: int
    end_ns: int
    steps: range
    unheard: tuple[int, ...]
    """Those whose scans had not been heard either."""


class Steps:
    """Each step is believed once; one that is missing needs an excuse.

    Excused is what the network could not carry while it was down, and what was not believed
    while there was no coordinator or no worker; how many that were is told. A coordinator that
    starts anew may say again what the last one had said, if it is the very same.
    """

    def __init__(self, availability: Availability) -> None:
        self._availability = availability
        self._last: tuple[int, int] | None = None
        self._believed = self._said_again = 0
        self._worst = 0.0
        self._gaps: list[_Gap] = []
        self._doubled: list[Break] = []
        self._said: OrderedDict[int, dict[int, float]] = OrderedDict()
        self._scans: OrderedDict[int, None] = OrderedDict()

    def scan(self, step: int) -> None:
        """A scan was heard."""
        self._scans[step] = None
        while len(self._scans) > _KEPT_BELIEFS:
            self._scans.popitem(last=False)

    def on_belief(self, at_ns: int, belief: Belief) -> None:
        """A belief was heard."""
        said = self._said.get(belief.step)
        if said is not None:
            self._repeated(at_ns, belief, said)
            return
        self._believed += 1
        self._said[belief.step] = _probabilities(belief)
        while len(self._said) > _KEPT_BELIEFS:
            self._said.popitem(last=False)
        if self._last is not None and belief.step > self._last[0] + 1:
            steps = range(self._last[0] + 1, belief.step)
            unheard = tuple(step for step in steps if step not in self._scans)
            self._gaps.append(_Gap(self._last[1], at_ns, steps, unheard))
        if self._last is None or belief.step > self._last[0]:
            self._last = belief.step, at_ns

    def verdicts(self) -> list[Verdict]:
        """On steps lost and on steps doubled."""
        broken: list[Break] = []
        lost = in_network = without_coordinator = without_workers = 0
        for gap in self._gaps:
            missing = [step for step in gap.steps if step not in self._said]
            time = gap.begin_ns, gap.end_ns
            if not missing:
                continue
            if self._availability.cut_off(*time):
                in_network += len(missing)
            elif self._availability.hit(_RESTARTS, *time, _RESTART_S):
                without_coordinator += len(missing)
            elif self._availability.hit(_NO_WORKERS, *time, _NO_WORKERS_S):
                without_workers += len(missing)
            else:
                lost += len(missing)
                what = f"{len(missing)} of steps {gap.steps.start} to {gap.steps.stop - 1}"
                unheard = f", {len(gap.unheard)} of whose scans were not heard"
                broken.append(Break(gap.end_ns, what + unheard))
        return [
            Verdict(
                promise="no step is lost",
                target="none but in outages",
                measured=f"{lost} of {self._believed:,}; in outages: network {in_network}, "
                f"coordinator {without_coordinator}, workers {without_workers}",
                kept=self._believed > 0 and not broken,
                breaks=tuple(broken[:KEPT_BREAKS]),
                figures={
                    "believed": self._believed,
                    "lost": lost,
                    "lost_without_network": in_network,
                    "lost_without_coordinator": without_coordinator,
                    "lost_without_workers": without_workers,
                },
            ),
            Verdict(
                promise="no step is believed twice",
                target=f"or the same within {SAME_WITHIN:.0e}",
                measured=f"{len(self._doubled)}; {self._said_again} said again by a new "
                f"coordinator, {self._worst:.0e} apart",
                kept=not self._doubled,
                breaks=tuple(self._doubled[:KEPT_BREAKS]),
                figures={
                    "doubled": len(self._doubled),
                    "said_again": self._said_again,
                    "worst": self._worst,
                },
            ),
        ]

    def _repeated(self, at_ns: int, belief: Belief, said: dict[int, float]) -> None:
        now = _probabilities(belief)
        apart = max((abs(now.get(c, 0.0) - said.get(c, 0.0)) for c in now | said), default=0.0)
        if not self._availability.hit(_RESTARTS, at_ns, at_ns, _REPLAY_S):
            self._doubled.append(Break(at_ns, f"step {belief.step} again"))
            return
        self._said_again += 1
        self._worst = max(self._worst, apart)
        if apart > SAME_WITHIN:
            self._doubled.append(Break(at_ns, f"step {belief.step} again, {apart:.1e} apart"))


def _probabilities(belief: Belief) -> dict[int, float]:
    return {place.cluster: place.probability for place in belief.hypotheses}
