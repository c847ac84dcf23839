"""The schedule of faults: a list, equal for equal seeds."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np

from tests.soak.fleet import BRIDGE, COORDINATOR, ROBOT, ROUTER, WORKER, WORKERS


class Kind(StrEnum):
    WORKER_KILLED = "worker killed"
    WORKER_FROZEN = "worker frozen"
    ALL_WORKERS_KILLED = "all workers killed"
    COORDINATOR_KILLED = "coordinator killed"
    COORDINATOR_FROZEN = "coordinator frozen"
    BRIDGE_KILLED = "bridge killed"
    ROBOT_FROZEN = "robot frozen"
    ROBOT_KIDNAPPED = "robot kidnapped"
    ROUTER_KILLED = "router killed"
    ROUTER_FROZEN = "router frozen"
    SLOW_NETWORK = "slow network"
    MALFORMED_MESSAGES = "malformed messages"


@dataclass(frozen=True)
class Rule:
    copies: int
    """Number in a deck of faults."""
    does: Literal["kill", "freeze", "send"]
    role: str = ""
    """Role of the victim."""
    lasts_s: tuple[float, float] = (0.0, 0.0)
    """Shortest and longest duration [s]."""


RULES = {
    Kind.WORKER_KILLED: Rule(10, "kill", WORKER),
    Kind.WORKER_FROZEN: Rule(4, "freeze", WORKER, (0.5, 5.0)),
    Kind.ALL_WORKERS_KILLED: Rule(1, "kill", WORKERS),
    Kind.COORDINATOR_KILLED: Rule(3, "kill", COORDINATOR),
    Kind.COORDINATOR_FROZEN: Rule(2, "freeze", COORDINATOR, (0.5, 4.0)),
    Kind.BRIDGE_KILLED: Rule(1, "kill", BRIDGE),
    Kind.ROBOT_FROZEN: Rule(2, "freeze", ROBOT, (1.5, 4.0)),
    Kind.ROBOT_KIDNAPPED: Rule(1, "send"),
    Kind.ROUTER_KILLED: Rule(1, "kill", ROUTER),
    Kind.ROUTER_FROZEN: Rule(1, "freeze", ROUTER, (0.5, 10.0)),
    Kind.SLOW_NETWORK: Rule(2, "freeze", ROUTER, (3.0, 6.0)),
    Kind.MALFORMED_MESSAGES: Rule(2, "send"),
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


@dataclass(frozen=True)
class DoneFault:
    kind: Kind
    at_ns: int
    until_ns: int
    """Equal to `at_ns` for an instantaneous fault."""
    target: str
    """Name of the affected process, or what was sent."""


def planned(
    seed: int, *, first_s: float, last_s: float, every_s: float, only: Sequence[Kind] = ()
) -> tuple[Fault, ...]:
    """Return all faults of a soak, dealt from shuffled decks; the first has one of each kind."""
    rng = np.random.default_rng([seed, 0xFA017])
    deck = _deck(rng, only or tuple(RULES))
    faults, at_s = [], first_s
    while at_s <= last_s:
        kind = next(deck)
        low, high = RULES[kind].lasts_s
        faults.append(Fault(at_s, kind, float(rng.uniform(low, high)), float(rng.random())))
        at_s += every_s * float(rng.uniform(_NEAREST, _FARTHEST))
    return tuple(faults)


def _deck(rng: np.random.Generator, kinds: Sequence[Kind]) -> Iterator[Kind]:
    yield from (kinds[index] for index in rng.permutation(len(kinds)))
    cards = [kind for kind in kinds for _ in range(RULES[kind].copies)]
    while True:
        yield from (cards[index] for index in rng.permutation(len(cards)))
