"""The schedule of faults: a list, equal for equal seeds."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np


class Kind(StrEnum):
    WORKER_KILLED = "worker killed"
    WORKER_FROZEN = "worker frozen"
    ALL_WORKERS_KILLED = "all workers killed"
    COORDINATOR_KILLED = "coordinator killed"
    WORKER_AND_COORDINATOR_KILLED = "worker and coordinator killed"
    COORDINATOR_FROZEN = "coordinator frozen"
    BRIDGE_KILLED = "bridge killed"
    ROBOT_FROZEN = "robot frozen"
    ROBOT_KIDNAPPED = "robot kidnapped"
    ROUTER_KILLED = "router killed"
    ROUTER_FROZEN = "router frozen"
    SLOW_NETWORK = "slow network"
    WORKER_LINKS_CUT = "worker links cut"
    COORDINATOR_LINK_CUT = "coordinator link cut"
    MALFORMED_MESSAGES = "malformed messages"
    WRONG_READINGS = "wrong readings"


@dataclass(frozen=True)
class _Rule:
    copies: int
    """Number in a deck of faults."""
    lasts_s: tuple[float, float] = (0.0, 0.0)
    """Shortest and longest duration [s]."""


_RULES = {
    Kind.WORKER_KILLED: _Rule(10),
    Kind.WORKER_FROZEN: _Rule(4, (0.5, 5.0)),
    Kind.ALL_WORKERS_KILLED: _Rule(1),
    Kind.COORDINATOR_KILLED: _Rule(3),
    Kind.WORKER_AND_COORDINATOR_KILLED: _Rule(2),
    Kind.COORDINATOR_FROZEN: _Rule(2, (0.5, 4.0)),
    Kind.BRIDGE_KILLED: _Rule(1),
    Kind.ROBOT_FROZEN: _Rule(2, (1.5, 4.0)),
    Kind.ROBOT_KIDNAPPED: _Rule(1),
    Kind.ROUTER_KILLED: _Rule(1),
    Kind.ROUTER_FROZEN: _Rule(1, (0.5, 10.0)),
    Kind.SLOW_NETWORK: _Rule(2, (3.0, 6.0)),
    Kind.WORKER_LINKS_CUT: _Rule(2, (1.0, 60.0)),
    Kind.COORDINATOR_LINK_CUT: _Rule(1, (1.0, 10.0)),
    Kind.MALFORMED_MESSAGES: _Rule(2),
    Kind.WRONG_READINGS: _Rule(1),
}
_NEAREST, _FARTHEST = 0.4, 1.6
"""Interval between faults as a multiple of the mean: the consequences of some overlap."""


@dataclass(frozen=True)
class Fault:
    at_s: float
    """Time after the start of the soak."""
    kind: Kind
    lasts_s: float
    """0: instantaneous."""
    choice: float
    """In [0, 1): selects the victim among the candidates at that time."""


def planned(
    seed: int, *, first_s: float, last_s: float, every_s: float, only: Sequence[Kind] = ()
) -> tuple[Fault, ...]:
    """Return all faults of a soak, dealt from shuffled decks; the first has one of each kind."""
    rng = np.random.default_rng([seed, 0xFA017])
    deck = _deck(rng, only or tuple(_RULES))
    faults, at_s = [], first_s
    while at_s <= last_s:
        kind = next(deck)
        low, high = _RULES[kind].lasts_s
        faults.append(Fault(at_s, kind, float(rng.uniform(low, high)), float(rng.random())))
        at_s += every_s * float(rng.uniform(_NEAREST, _FARTHEST))
    return tuple(faults)


def _deck(rng: np.random.Generator, kinds: Sequence[Kind]) -> Iterator[Kind]:
    yield from (kinds[index] for index in rng.permutation(len(kinds)))
    cards = [kind for kind in kinds for _ in range(_RULES[kind].copies)]
    while True:
        yield from (cards[index] for index in rng.permutation(len(cards)))
