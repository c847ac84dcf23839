"""Steps of a simulated robot."""

from collections.abc import Iterator

from msgspec.structs import replace

from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Observation, Scan
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.step_maker import StepMaker
from clustermcl.simulator.simulation import Simulation


def simulated_steps(
    simulation: Simulation,
    settings: BridgeSettings,
    grid_map: GridMap | None = None,
    *,
    steps: int | None = None,
) -> Iterator[tuple[Scan, PoseTuple]]:
    """Yield the steps that a bridge would make, each with the true pose; without `steps`, no end.

    `grid_map` is the one to localize in; None: the world's own.
    """
    known, landmarks = grid_map or simulation.world.map, simulation.world.landmarks
    maker = StepMaker(settings, known.digest, "simulator", landmarks=landmarks, floors=known.floors)
    made = 0
    while made != steps:
        tick = next(simulation)
        for message in tick.messages:
            if isinstance(message, Observation):
                maker.observe(message)
            elif (scan := maker.on_reading(message)) is not None:
                made += 1
                yield replace(scan, last=made == steps), tick.map_from_robot
