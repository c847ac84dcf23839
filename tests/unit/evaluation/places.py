"""Hypotheses and beliefs for tests."""

from typing import Any

from clustermcl.belief.outcome import Outcome
from clustermcl.protocol.answers import Belief, Hypothesis, PoseAnswer, State, Status
from clustermcl.protocol.health import Health
from clustermcl.protocol.message import Covariance, PoseTuple

COVARIANCE: Covariance = (0.04, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.0025)


def place(
    probability: float,
    mean: PoseTuple = (0.0, 0.0, 0.0),
    *,
    cluster: int = 0,
    covariance: Covariance = COVARIANCE,
) -> Hypothesis:
    return Hypothesis(
        cluster=cluster,
        probability=probability,
        log_probability=0.0,
        pose=mean,
        covariance=covariance,
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


def outcome(
    state: State, *hypotheses: Hypothesis, elsewhere: float | None = None, off_map: float = 0.0
) -> Outcome:
    return Outcome(
        step=0,
        state=state,
        hypotheses=hypotheses,
        elsewhere_probability=elsewhere,
        off_map_probability=off_map,
        searching=False,
        missing=(),
        begin={},
        events=(),
    )


ANSWER = PoseAnswer(
    sender="coordinator", state="localized", freshness="fresh", stamp_ns=7, age_s=0.5, step=3,
    probability=0.95, pose=(1.0, 2.0, 3.0), covariance=COVARIANCE, workers=4,
    elsewhere_probability=0.005,
)  # fmt: skip
STATUS = Status(
    sender="coordinator", version="1.2", state="localized", freshness="fresh", age_s=0.25,
    step=41, steps_applied=40, steps_lost=1, reports_missing=2, map_digest="abc", clusters=3,
    searching=True, workers={"worker-0": ("c1", "c2")},
    counters={"scan of another map": 7}, uptime_s=99.0,
    processes=(
        Health(sender="coordinator", role="coordinator", version="1.2", uptime_s=99.0,
               memory_bytes=50_000_000, dropped={"scan of another map": 7}),
        Health(sender="worker-0", role="worker", version="1.1", uptime_s=9.0, age_s=5.0,
               done={"reports": 80}, rates_per_s={"reports": 9.5}, ages_s={"reports": 0.25}),
    ),
)  # fmt: skip
