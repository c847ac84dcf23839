"""The steps of one run, with true poses, of a simulated or a recorded robot."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec

from clustermcl.evaluation.references import load_reference
from clustermcl.protocol.errors import MapFileError
from clustermcl.protocol.floors import Floors
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.recordings.recording import Recording, open_recording
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.runtime.sources import Simulated
from clustermcl.sensor_bridge.recorded import steps_of
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.source import simulated_steps
from clustermcl.simulator.worlds.catalogue import simulated_world

TrueStep = tuple[Scan, PoseTuple | None]


class SimulatedRobot(msgspec.Struct, frozen=True, kw_only=True):
    """A robot to simulate."""

    world: str
    """Name of a world, or a map file."""
    map: Path | None = None
    """Map for the localizer; None: the world's own map."""
    floor: str = ""
    """Floor of `map` in which the robot drives, if that is a building and the world is not."""

    def simulation(self, seed: int) -> Simulation:
        return Simulation(simulated_world(Simulated(self.world)), seed)


class RecordedRobot(msgspec.Struct, frozen=True, kw_only=True):
    """A recording of a robot, with its map and perhaps the ground truth."""

    recording: Path
    map: Path
    reference: Path | None = None
    """File with the ground truth; None: the ground truth is unknown, so no step is scored."""
    floor: str = ""
    """Floor of the ground truth, if `map` is a building."""

    def opened(self, settings: BridgeSettings) -> Recording:
        return open_recording(self.recording, settings)


class Case(msgspec.Struct, frozen=True, kw_only=True):
    """A robot and the length of a run."""

    robot: SimulatedRobot | RecordedRobot
    updates: int | None = None
    """Largest number of steps; None: to the end of the recording."""


@dataclass(frozen=True)
class Course:
    """The steps of one run."""

    map: GridMap
    map_name: str
    """File or world of the map, for errors."""
    steps: Iterator[TrueStep]
    simulation: Simulation | None


def course_of(case: Case, seed: int, settings: BridgeSettings, start_step: int = 0) -> Course:
    """Begin a run; a file that cannot be used may raise its error only at the first step."""
    match case.robot:
        case SimulatedRobot() as robot:
            simulation = robot.simulation(seed)
            grid_map = load_map(robot.map) if robot.map else simulation.world.map
            known: Iterator[TrueStep] = simulated_steps(
                simulation, settings, grid_map, steps=case.updates
            )
            if robot.map:
                known = _in_atlas(known, grid_map.floors, robot)
            return Course(grid_map, str(robot.map or robot.world), known, simulation)
        case RecordedRobot() as robot:
            grid_map = load_map(robot.map)
            reference = load_reference(robot.reference) if robot.reference else None
            recording = robot.opened(settings)
            scans = steps_of(recording, settings, grid_map.digest, grid_map.floors)
            end = None if case.updates is None else start_step + case.updates
            true_steps: Iterator[TrueStep] = (
                (scan, reference.pose_at(scan.stamp_ns) if reference else None)
                for scan in itertools.islice(scans, start_step, end)
            )
            if reference:
                true_steps = _in_atlas(true_steps, grid_map.floors, robot)
            return Course(grid_map, str(robot.map), true_steps, None)


def _in_atlas(
    steps: Iterator[TrueStep], floors: Floors, robot: SimulatedRobot | RecordedRobot
) -> Iterator[TrueStep]:
    """Return steps with true poses in the atlas of a building.

    Raises:
        MapFileError: the robot's floor is none of the map.
    """
    try:
        floors.in_atlas(robot.floor, (0.0, 0.0, 0.0))
    except ValueError as error:
        raise MapFileError(robot.map or "", f"--floor: {error}") from None
    return ((scan, truth and floors.in_atlas(robot.floor, truth)) for scan, truth in steps)
