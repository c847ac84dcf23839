"""Promise: every step is believed once."""

from collections import OrderedDict

from clustermcl.soak.availability import Availability
from clustermcl.soak.schedule import Kind
from clustermcl.soak.verdict import KEPT_BREAKS, Break, Verdict
from protocol.answers import Belief

SAME_WITHIN = 1e-9
_RESTARTS = {Kind.COORDINATOR_KILLED, Kind.COORDINATOR_FROZEN}
_RESTART_S = 5.0
_REPLAY_S = 30.0
_KEPT_BELIEFS = 4096


class Steps:
    """Each step is believed once; one that is missing needs an excuse.

    Excused is what the network could not carry while it was down, and what a coordinator that
    was not there has not believed; how many that were is told. A coordinator that starts anew
    may say again what the last one had said, if it is the very same.
    """

    def __init__(self, availability: Availability) -> None:
        self._availability = availability
        self._last: tuple[int, int] | None = None
        self._believed = self._said_again = 0
        self._worst = 0.0
        self._gaps: list[tuple[int, int, int, int]] = []
        self._doubled: list[Break] = []
        self._said: OrderedDict[int, dict[int, float]] = OrderedDict()

    def take(self, at_ns: int, belief: Belief) -> None:
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
            self._gaps.append((self._last[1], at_ns, self._last[0] + 1, belief.step - 1))
        if self._last is None or belief.step > self._last[0]:
            self._last = belief.step, at_ns

    def verdicts(self) -> list[Verdict]:
        """On steps lost and on steps doubled."""
        broken: list[Break] = []
        lost = in_network = without_coordinator = 0
        for begin_ns, end_ns, first, last in self._gaps:
            missing = sum(step not in self._said for step in range(first, last + 1))
            if missing == 0:
                continue
            if self._availability.cut_off(begin_ns, end_ns):
                in_network += missing
            elif self._availability.hit(_RESTARTS, begin_ns, end_ns, _RESTART_S):
                without_coordinator += missing
            else:
                lost += missing
                broken.append(Break(end_ns, f"{missing} of steps {first} to {last}"))
        return [
            Verdict(
                promise="no step is lost",
                target="none but in outages",
                measured=f"{lost} of {self._believed:,}; in outages: network {in_network}, "
                f"coordinator {without_coordinator}",
                kept=self._believed > 0 and not broken,
                breaks=tuple(broken[:KEPT_BREAKS]),
                figures={
                    "believed": self._believed,
                    "lost": lost,
                    "lost_without_network": in_network,
                    "lost_without_coordinator": without_coordinator,
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
