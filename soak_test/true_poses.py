"""Brings each belief together with the robot's true pose at its scan."""

from collections import OrderedDict
from dataclasses import dataclass

from protocol.answers import Belief
from protocol.message import PoseTuple

_KEPT_TRUTHS = 4096
_WAITING_BELIEFS = 64


@dataclass(frozen=True)
class JudgedBelief:
    """A belief whose truth is known."""

    at_ns: int
    belief: Belief
    truth: PoseTuple
    """`map_from_robot` at the belief's scan."""
    kidnapped: int = 0
    """How often the robot had been lifted to another place by then."""

    @property
    def blind(self) -> bool:
        """Whether no worker has reported to it: its places are where they were."""
        places = self.belief.hypotheses
        return bool(places) and all(f"c{p.cluster}" in self.belief.missing for p in places)


class TruePoses:
    """Told of true poses and beliefs in any order; answers with those that belong together."""

    def __init__(self) -> None:
        self._truths: OrderedDict[int, tuple[PoseTuple, int]] = OrderedDict()
        self._waiting: OrderedDict[int, tuple[int, Belief]] = OrderedDict()
        self.unknown = 0
        """Beliefs whose truth was never heard."""

    def truth(self, stamp_ns: int, pose: PoseTuple, kidnapped: int = 0) -> JudgedBelief | None:
        """Where the robot was when it took a scan; the belief that waited for it, if one did."""
        self._truths[stamp_ns] = pose, kidnapped
        while len(self._truths) > _KEPT_TRUTHS:
            self._truths.popitem(last=False)
        held = self._waiting.pop(stamp_ns, None)
        return None if held is None else JudgedBelief(*held, pose, kidnapped)

    def on_belief(self, at_ns: int, belief: Belief) -> JudgedBelief | None:
        """A belief was heard; None while its truth is still on its way."""
        truth = self._truths.get(belief.stamp_ns)
        if truth is not None:
            return JudgedBelief(at_ns, belief, *truth)
        self._waiting[belief.stamp_ns] = at_ns, belief
        while len(self._waiting) > _WAITING_BELIEFS:
            self._waiting.popitem(last=False)
            self.unknown += 1
        return None
