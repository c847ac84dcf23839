"""A simulated robot that observes, and the beliefs of the library while it drives."""

import math
from collections.abc import Callable, Iterable, Iterator
from itertools import islice

import numpy as np

from clustermcl import ClusterMCL, Reading
from clustermcl.filter.poses import between
from clustermcl.filter.settings import FilterSettings
from clustermcl.localizer import Belief
from clustermcl.protocol import answers
from clustermcl.protocol.steps import Landmark
from clustermcl.simulator.simulation import Simulation, Tick
from clustermcl.simulator.worlds.catalogue import world

OFFICE = world("office")
CROSS = world("cross")
"""Of four equal arms, with a tag in each of two arms."""
_LOW = CROSS.map.map_from_grid[:2]
_SIDES_M = np.array(CROSS.map.cells.shape[::-1]) * CROSS.map.cell_m
CENTRE = _LOW + _SIDES_M / 2.0
REACH_M = 0.35 * float(_SIDES_M[0])
TAGS = tuple(
    Landmark(name=name, x=float(CENTRE[0] + x), y=float(CENTRE[1] + y), sigma=0.05)
    for name, x, y in (("east", REACH_M, 0.0), ("north", 0.0, REACH_M))
)
SIGMA_M = 0.1
SEEN_WITHIN_M = 3.0


def driven(
    mcl: ClusterMCL, ticks: Iterable[Tick], observe: Callable[[Tick], object] = lambda _tick: None
) -> Iterator[tuple[Belief, Tick]]:
    """Yield each belief with the tick at which it came; `observe` is called before each scan."""
    for tick in ticks:
        for reading in tick.readings:
            if reading is tick.laser:
                observe(tick)
            if belief := mcl.update(Reading.of(reading)):
                yield belief, tick


def sight(
    tick: Tick,
    rng: np.random.Generator,
    false: float = 0.0,
    tags: tuple[Landmark, ...] = TAGS,
    within_m: float = SEEN_WITHIN_M,
) -> tuple[str, np.ndarray] | None:
    """Name and position in the robot's frame of the tag that a camera sees, if it sees one."""
    for tag in tags:
        seen = between(np.array(tick.map_from_robot), np.array([tag.x, tag.y, 0.0]))[:2]
        if math.hypot(*seen) < within_m:
            name = tag.name if rng.random() >= false else str(rng.choice([t.name for t in tags]))
            return name, seen + rng.normal(size=2) * SIGMA_M
    return None


def observe(
    mcl: ClusterMCL, tick: Tick, seen: tuple[str, np.ndarray] | None, **how: object
) -> None:
    if seen is not None:
        name, position = seen
        covariance, stamp_ns = np.eye(2) * SIGMA_M**2, tick.laser.stamp_ns
        mcl.observe(position, covariance, landmark=name, stamp_ns=stamp_ns, **how)


def beliefs(
    seed: int, settings: FilterSettings, ticks: int, false: float = 0.0, observes: bool = True
) -> Iterator[tuple[Belief, Tick, bool]]:
    """Yield each belief, the tick at which it came, and whether a tag was seen before."""
    mcl = ClusterMCL(CROSS.map, landmarks=TAGS, settings=settings, seed=seed)
    rng, has_seen = np.random.default_rng(seed), False

    def look(tick: Tick) -> None:
        nonlocal has_seen
        seen = sight(tick, rng, false)
        if observes and seen is not None:
            observe(mcl, tick, seen, outlier_probability=max(false, 0.05))
            has_seen = True

    for belief, tick in driven(mcl, islice(Simulation(CROSS, seed), ticks), look):
        yield belief, tick, has_seen


def is_right(belief: answers.Belief, tick: Tick) -> bool:
    return math.dist(belief.hypotheses[0].pose[:2], tick.map_from_robot[:2]) < 1.0
