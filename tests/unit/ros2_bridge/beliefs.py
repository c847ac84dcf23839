"""Small beliefs, as a coordinator publishes them."""

from protocol.answers import Belief, Hypothesis, State
from protocol.message import Covariance, PoseTuple

COVARIANCE: Covariance = (0.04, 0.01, 0.0, 0.01, 0.09, 0.0, 0.0, 0.0, 0.02)


def belief(
    stamp_ns: int, *places: tuple[int, float, PoseTuple], state: State = "ambiguous", term: int = 1
) -> Belief:
    """Places are cluster, probability and pose, most probable first."""
    return Belief(
        sender="coordinator",
        step=stamp_ns,
        stamp_ns=stamp_ns,
        odom_from_robot=(0.0, 0.0, 0.0),
        state=state,
        hypotheses=tuple(
            Hypothesis(
                cluster=cluster,
                probability=probability,
                log_probability=0.0,
                pose=mean,
                covariance=COVARIANCE,
                effective_sample_size=100.0,
                age_steps=3,
            )
            for cluster, probability, mean in places
        ),
        searching=False,
        term=term,
    )
