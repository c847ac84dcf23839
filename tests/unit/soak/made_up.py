"""Messages and faults of a soak, made up."""

from protocol.answers import Belief, Hypothesis, PoseAnswer
from protocol.message import PoseTuple
from tests.soak.promises import DoneFault, Outages, Question
from tests.soak.schedule import Kind

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
    return Hypothesis(
        cluster=cluster,
        probability=probability,
        log_probability=0.0,
        mean=mean,
        covariance=(0.0,) * 9,
        effective_sample_size=1.0,
        age_steps=1,
    )


def belief(
    step: int, *places: Hypothesis, stamp_s: float = 0.0, missing: tuple[str, ...] = ()
) -> Belief:
    return Belief(
        sender="coordinator",
        step=step,
        stamp_ns=at(stamp_s),
        odom_from_robot=(0.0, 0.0, 0.0),
        state="ambiguous",
        hypotheses=places,
        searching=False,
        missing=missing,
    )


def unanswered(asked_s: float) -> Question:
    return Question(at(asked_s), at(asked_s + 0.01), None)


def answered(
    asked_s: float, *, stamp_s: float, age_s: float, fresh: bool = True, took_s: float = 0.01
) -> Question:
    answer = PoseAnswer(
        sender="coordinator",
        state="localized",
        freshness="fresh" if fresh else "stale",
        stamp_ns=at(stamp_s),
        age_s=age_s,
        step=1,
        probability=1.0,
        map_from_robot=(0.0, 0.0, 0.0),
        covariance=(0.0,) * 9,
        workers=1,
    )
    return Question(at(asked_s), at(asked_s + took_s), answer)
