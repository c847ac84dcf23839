"""What goes wrong in a schedule, and when: drawn from its seed before it begins."""

import random
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

from clustermcl.coordinator.events import CommandArrived
from clustermcl.protocol.answers import Relocalize, SetPose
from tests.simulation.network import Node

if TYPE_CHECKING:
    from tests.simulation.simulation import Simulation

Fault: TypeAlias = Callable[["Simulation"], None]
FaultMaker: TypeAlias = Callable[[random.Random], Fault]
Victims: TypeAlias = Callable[["Simulation"], Sequence[Node]]
WALL_US = 1_800_000_000_000_000
HOUR_US = 3_600_000_000
YEAR_US = 365 * 24 * HOUR_US


class Schedule:
    """How the network is, what the clocks show, and which faults come when."""

    def __init__(self, rng: random.Random) -> None:
        self.workers = rng.choice((2, 2, 3, 4))
        self.loss = rng.choice((0.0, 0.0, 0.02, 0.1))
        self.doubled = rng.choice((0.0, 0.0, 0.1))
        self.least_s = rng.choice((0.0002, 0.005))
        self.jitter_s = rng.choice((0.001, 0.01, 0.05))
        self.period_s = rng.choice((0.3, 0.5, 0.9))
        self.lockstep = rng.random() < 0.2
        """Each step waits for the belief of the one before, as in a recording."""
        self.wall_us = [
            WALL_US + rng.randrange(1_000_000) + rng.choice((0, 0, HOUR_US, -50 * YEAR_US))
            for _ in range(2)
        ]
        """When the coordinators' wall clocks say that the schedule begins."""
        at_s, self.faults = 1.2, list[tuple[float, Fault]]()
        for _ in range(rng.randrange(1, 6)):
            self.faults.append((at_s, _fault(rng)))
            at_s += rng.choice((0.0, 0.05, 0.4, 1.0, 2.0))
        self.calm_at_s = at_s + 0.5

    def offset_s(self, rng: random.Random) -> float:
        return rng.choice((0.0, 1.0, 1e4)) + rng.random()


def _coordinator(_rng: random.Random) -> Victims:
    return lambda simulation: [simulation.acting() or simulation.coordinators["c0"]]


def _worker(rng: random.Random) -> Victims:
    which = rng.random()
    return lambda simulation: [[*simulation.workers.values()][int(which * len(simulation.workers))]]


def _all_workers(_rng: random.Random) -> Victims:
    return lambda simulation: [*simulation.workers.values()]


def _bridge(_rng: random.Random) -> Victims:
    return lambda simulation: [simulation.bridge]


def _killed(*choices: Callable[[random.Random], Victims], away_s: Sequence[float]) -> FaultMaker:

    def maker(rng: random.Random) -> Fault:
        chosen, away = [choose(rng) for choose in choices], rng.choice(away_s)

        def fault(simulation: "Simulation") -> None:
            for victims in chosen:
                for node in filter(lambda node: node.alive, victims(simulation)):
                    simulation.network.kill(node)
                    simulation.clock.after(away, partial(simulation.network.start, node))

        return fault

    return maker


def _frozen(choose: Callable[[random.Random], Victims], seconds: Sequence[float]) -> FaultMaker:
    def maker(rng: random.Random) -> Fault:
        victims, for_s = choose(rng), rng.choice(seconds)

        def fault(simulation: "Simulation") -> None:
            for node in victims(simulation):
                simulation.network.freeze(node, for_s)

        return fault

    return maker


def _worker_slow(rng: random.Random) -> Fault:
    victims, late_s, seconds = _worker(rng), rng.choice((0.2, 0.5)), rng.choice((1.0, 3.0))

    def fault(simulation: "Simulation") -> None:
        (worker,) = victims(simulation)
        worker.slow_s = late_s
        simulation.clock.after(seconds, lambda: setattr(worker, "slow_s", 0.0))

    return fault


def _cut(rng: random.Random) -> Fault:
    which, seconds = rng.random(), rng.choice((0.1, 0.6, 1.8, 2.5, 4.0))
    inwards, outwards = rng.choice(((True, True), (True, False), (False, True)))

    def fault(simulation: "Simulation") -> None:
        nodes = [*simulation.network.nodes.values()]
        node = nodes[int(which * len(nodes))]
        simulation.network.cut(node, inwards=inwards, outwards=outwards)
        simulation.clock.after(seconds, lambda: simulation.network.mend(node))

    return fault


def _robot_stands(rng: random.Random) -> Fault:
    seconds = rng.choice((1.0, 3.0))

    def fault(simulation: "Simulation") -> None:
        simulation.stands = True
        simulation.clock.after(seconds, lambda: setattr(simulation, "stands", False))

    return fault


def _command(rng: random.Random) -> Fault:
    command: SetPose | Relocalize
    name = f"{rng.random()}"
    if rng.random() < 0.5:
        command = Relocalize(sender="person", command_id=name)
    else:
        command = SetPose(sender="person", command_id=name, pose=(3.0, 2.0, 0.0))

    def fault(simulation: "Simulation") -> None:
        for node in simulation.coordinators.values():
            if node.acts:
                node.take(lambda node=node: node.pass_on(CommandArrived(command)))  # type: ignore[misc]

    return fault


KINDS: list[tuple[int, FaultMaker]] = [
    (6, _killed(_coordinator, away_s=(0.05, 0.5, 3.0))),
    (3, _frozen(_coordinator, (0.3, 0.9, 1.5, 3.0))),
    (3, _killed(_coordinator, _worker, away_s=(0.05, 1.0, 3.0))),
    (4, _killed(_worker, away_s=(0.02, 0.5, 2.0))),
    (1, _killed(_all_workers, away_s=(0.05, 0.5))),
    (2, _frozen(_worker, (0.2, 1.0, 3.0))),
    (2, _worker_slow),
    (4, _cut),
    (1, _killed(_bridge, away_s=(0.1, 1.0))),
    (2, _command),
    (2, _robot_stands),
]
"""How often each fault comes, and what it is."""


def _fault(rng: random.Random) -> Fault:
    weights, makers = zip(*KINDS, strict=True)
    (maker,) = rng.choices(makers, weights)
    return maker(rng)
