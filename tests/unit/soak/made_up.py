"""Messages and faults of a soak, made up."""

from msgspec.structs import replace

from protocol.answers import Belief, Hypothesis
from protocol.message import PoseTuple
from tests.soak.promises import DoneFault, Outages, Question
from tests.soak.schedule import Kind
from tests.unit.live_view import messages

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


def at(seconds: float) -> int:
    """That long after the start [ns]."""
    return START + round(seconds * SECOND)


def outages(*faults: DoneFault) -> Outages:
    known = Outages()
    known.faults += faults
    return known


def fault(kind: Kind, begin_s: float, lasts_s: float = 0.0, target: str = "") -> DoneFault:
    return DoneFault(kind, at(begin_s), at(begin_s + lasts_s), target)


def place(cluster: int, probability: float, mean: PoseTuple = (0.0, 0.0, 0.0)) -> Hypothesis:
    return replace(messages.hypothesis(cluster, probability), pose=mean)


def belief(
    step: int, *places: Hypothesis, stamp_s: float = 0.0, missing: tuple[str, ...] = ()
) -> Belief:
    made = messages.belief(step)
    return replace(made, stamp_ns=at(stamp_s), hypotheses=places, missing=missing)


def unanswered(asked_s: float) -> Question:
    return Question(at(asked_s), at(asked_s + 0.01), None)


def answered(
    asked_s: float, *, stamp_s: float, age_s: float, fresh: bool = True, took_s: float = 0.01
) -> Question:
    freshness = "fresh" if fresh else "stale"
    answer = messages.pose(1, freshness=freshness, stamp_ns=at(stamp_s), age_s=age_s)
    return Question(at(asked_s), at(asked_s + took_s), answer)
