"""Readings and steps of a simulated robot."""

from collections import deque
from collections.abc import Iterator

import msgspec

from clustermcl.protocol.floors import ONE_MAP, Floors
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Observation, Reading, Scan
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.step_maker import StepMaker
from clustermcl.simulator.simulation import Simulation


class SimulatedSource:
    """The readings of a simulated robot, up to a number of steps; None: without end."""

    def __init__(self, simulation: Simulation, *, steps: int | None = None) -> None:
        self.steps, self._simulation = steps, simulation
        self._steps_made = 0
        self._tick: deque[Reading | Observation] = deque()
        self._truth = simulation.map_from_robot
        self.landmarks = simulation.world.landmarks

    def next_reading(self) -> Reading | Observation | None:
        """Return the next reading in the order of time; None after the last step."""
        if not self._tick:
            if self._steps_made == self.steps:
                return None
            tick = next(self._simulation)
            self._truth = tick.map_from_robot
            before, scan, after = tick.readings
            self._tick.extend((before, *tick.observations, scan, after))
        return self._tick.popleft()

    def step_made(self) -> PoseTuple:
        """Count a step, and return the true pose at its scan.

        A scan becomes a step at the odometry after it, which is of the same tick.
        """
        self._steps_made += 1
        return self._truth


def simulated_steps(
    source: SimulatedSource, settings: BridgeSettings, map_digest: str, floors: Floors = ONE_MAP
) -> Iterator[tuple[Scan, PoseTuple]]:
    """Yield the steps that a bridge would make of a source, each with the true pose."""
    sender, landmarks = "simulator", source.landmarks
    maker = StepMaker(settings, map_digest, sender, landmarks=landmarks, floors=floors)
    made = 0
    while (reading := source.next_reading()) is not None:
        if isinstance(reading, Observation):
            maker.observe(reading)
            continue
        scan = maker.on_reading(reading)
        if scan is not None:
            made += 1
            scan = msgspec.structs.replace(scan, last=made == source.steps)
            yield scan, source.step_made()
