"""Advice where to drive: the question to a worker, and the answer that clients get."""

from collections.abc import Iterable
from itertools import islice
from typing import Annotated, ClassVar

from msgspec import Meta

from clustermcl.protocol.answers import Hypothesis
from clustermcl.protocol.message import (
    LIST_BYTES,
    Finite,
    Message,
    NotNegative,
    Part,
    PoseTuple,
    Probability,
    ScanStep,
)
from clustermcl.protocol.steps import Scan

LEAST_PROBABILITY = 0.01
"""Ways keep clear of obstacles at all places with at least this probability."""
MAX_PLACES = 64
"""Number of the most probable places that are distinguished."""
MAX_VIEWS_BYTES = 4096
"""256 views of four numbers."""
USUAL_RADIUS_M = 0.3
"""Radius of a robot whose settings do not have one [m]."""


class AdviceQuestion(Message, frozen=True, kw_only=True, tag="advice_question/2"):
    """The belief after a step. A query of the coordinator on ``worker/{name}/advice``."""

    max_bytes: ClassVar[int] = LIST_BYTES
    step: ScanStep
    """The step, whose scan the worker has."""
    map_digest: str
    """As in `Scan`."""
    hypotheses: Annotated[tuple[Hypothesis, ...], Meta(max_length=MAX_PLACES)]
    """The places to distinguish."""
    elsewhere_probability: Probability
    """Probability that the robot is at none of the tracked places."""
    views: Annotated[bytes, Meta(max_length=MAX_VIEWS_BYTES)] = b""
    """The robot's earlier views, as in `clustermcl.filter.advice.view_memory`."""
    radius_m: Annotated[float, Meta(ge=0.0, le=10.0)]
    """Radius of the robot."""
    gate_distance_m: NotNegative
    """Distance between two steps."""
    gate_turn_rad: NotNegative
    """Turn between two steps."""


def advice_question(
    places: Iterable[Hypothesis],
    elsewhere_probability: float,
    scan: Scan,
    views: bytes,
    gate: tuple[float, float],
    *,
    radius_m: float,
    sender: str,
) -> AdviceQuestion:
    """Return the question for ways that distinguish places of a belief, most probable first.

    `gate` is the distance [m] and turn [rad] between two steps; others as in `AdviceQuestion`.
    """
    probable = (place for place in places if place.probability >= LEAST_PROBABILITY)
    return AdviceQuestion(
        sender=sender,
        step=scan.step,
        map_digest=scan.map_digest,
        hypotheses=tuple(islice(probable, MAX_PLACES)),
        elsewhere_probability=elsewhere_probability,
        radius_m=radius_m,
        views=views,
        gate_distance_m=gate[0],
        gate_turn_rad=gate[1],
    )


class Way(Part, frozen=True, kw_only=True):
    """A way that is free at all places, and its expected information."""

    poses: tuple[PoseTuple, ...]
    """Relative to the robot at the step: x [m] ahead, y [m] to the left, heading [rad]."""
    rest: tuple[PoseTuple, ...] = ()
    """Where the way leads from there. Ask again first: places are not known well enough yet."""
    length_m: NotNegative
    """Length of both."""
    gains: tuple[Finite, ...] = ()
    """Expected gain of the log probability of each of `Advice.clusters`, if it is right [nat]."""
    information: NotNegative
    """Mean of these, weighted by the probability that the place is right."""
    sure_probability: Probability
    """Probability that the robot is localized after the way."""


class Advice(Message, frozen=True, kw_only=True, tag="advice/1"):
    """Ways that distinguish the robot's possible places. Answers ``advice``."""

    max_bytes: ClassVar[int] = LIST_BYTES
    step: int = -1
    """The step whose belief the advice is for; -1: there was none yet."""
    stamp_ns: int = 0
    """Robot's clock at that step's scan."""
    odom_from_robot: PoseTuple = (0.0, 0.0, 0.0)
    """Odometry at that scan, where all ways begin."""
    clusters: tuple[int, ...] = ()
    """The places to distinguish, most probable first."""
    places: tuple[PoseTuple, ...] = ()
    """Pose of each of these in the map at that step."""
    ways: tuple[Way, ...] = ()
    """The best for its length first, by information and probability of being localized."""
    spots: tuple[tuple[Finite, Finite, NotNegative], ...] = ()
    """View points on ways that are free at all places: x [m] ahead, y [m] to the left, and the
    expected information of a new view there [nat]."""
    note: str = ""
    """Why there is no way, or what else to know; may be empty."""
