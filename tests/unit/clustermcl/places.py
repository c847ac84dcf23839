"""Hypotheses and beliefs for tests."""

from typing import Any

from protocol.answers import Belief, Hypothesis, State
from protocol.message import Covariance, PoseTuple

COVARIANCE: Covariance = (0.04, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.0025)


def place(probability: float, mean: PoseTuple = (0.0, 0.0, 0.0), *, cluster: int = 0) -> Hypothesis:
    return Hypothesis(
        cluster=cluster,
        probability=probability,
        log_probability=0.0,
        mean=mean,
        covariance=COVARIANCE,
        effective_sample_size=100.0,
        age_steps=5,
    )


def belief(step: int, state: State, *hypotheses: Hypothesis, **more: Any) -> Belief:
    return Belief(
        sender="coordinator",
        step=step,
        stamp_ns=step * 10**9,
        odom_from_robot=(0.0, 0.0, 0.0),
        state=state,
        hypotheses=hypotheses,
        **{"searching": False, **more},
    )
