"""A robot in a cross of four equal arms, with a tag in each of two arms."""

import math
from collections.abc import Iterator
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

CROSS = world("cross")
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


def beliefs(
    seed: int, settings: FilterSettings, ticks: int, false: float = 0.0, observes: bool = True
) -> Iterator[tuple[Belief, Tick, bool]]:
    """Yield each belief, the tick at which it came, and whether a tag was seen before."""
    mcl = ClusterMCL(CROSS.map, landmarks=TAGS, settings=settings, seed=seed)
    rng, has_seen = np.random.default_rng(seed), False
    for tick in islice(Simulation(CROSS, seed), ticks):
        seen = sight(tick, rng, false)
        for reading in (tick.odometry[0], tick.laser, tick.odometry[1]):
            if reading is tick.laser and seen is not None and observes:
                name, position = seen
                mcl.observe(
                    position,
                    np.eye(2) * SIGMA_M**2,
                    landmark=name,
                    stamp_ns=tick.laser.stamp_ns,
                    outlier_probability=max(false, 0.05),
                )
                has_seen = True
            if belief := mcl.update(Reading.of(reading)):
                yield belief, tick, has_seen


def is_right(belief: answers.Belief, tick: Tick) -> bool:
    return math.dist(belief.hypotheses[0].pose[:2], tick.map_from_robot[:2]) < 1.0
