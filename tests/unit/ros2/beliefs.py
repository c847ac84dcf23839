"""Small beliefs, as a coordinator publishes them."""

from msgspec.structs import replace

from clustermcl.protocol.answers import Belief, State
from clustermcl.protocol.message import Covariance, PoseTuple
from tests.unit.evaluation import places as made

COVARIANCE: Covariance = (0.04, 0.01, 0.0, 0.01, 0.09, 0.0, 0.0, 0.0, 0.02)


def belief(
    stamp_ns: int, *places: tuple[int, float, PoseTuple], state: State = "ambiguous", term: int = 1
) -> Belief:
    """Places are cluster, probability and pose, most probable first."""
    drawn = [
        replace(made.place(probability, mean, cluster=cluster), covariance=COVARIANCE)
        for cluster, probability, mean in places
    ]
    return replace(made.belief(stamp_ns, state, *drawn, term=term), stamp_ns=stamp_ns)
