"""The steps of one run with the true poses, whether the robot is simulated or recorded."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from evaluation.experiments.case import Case
from evaluation.references import Reference, load_reference
from grid_maps.grid_map import GridMap
from grid_maps.load import load_map
from process_runtime.settings import BridgeSettings
from protocol.message import PoseTuple
from protocol.pose_arrays import pose_tuple
from protocol.steps import Scan
from robot_simulator.simulation import Simulation
from robot_simulator.source import SimulatedSource, simulated_steps
from robot_simulator.worlds.catalogue import world
from sensor_bridge.recording import open_recording
from sensor_bridge.step_maker import steps_of

TrueStep = tuple[Scan, PoseTuple | None]
"""A step, and where the robot was at its scan; None where nobody knows."""


@dataclass(frozen=True)
class Course:
    """Where a robot goes in one run."""

    map: GridMap
    """What the localizer is given."""
    steps: Iterator[TrueStep]
    """Lazily: the next step is made when it is asked for."""
    kidnap: Callable[[], object]
    """Lift the robot to somewhere far away before the next step; not of a recording."""


def course_of(case: Case, seed: int, settings: BridgeSettings) -> Course:
    """Begin a run.

    Args:
        case: the experiment.
        seed: of the simulated robot; a recording is always the same.
        settings: the motion gate.

    Raises:
        ClusterMclError: a file cannot be used, or the world does not exist.
    """
    return _simulated(case, seed, settings) if case.world else _recorded(case, settings)


def _simulated(case: Case, seed: int, settings: BridgeSettings) -> Course:
    place = world(case.world)
    source = SimulatedSource(Simulation(place, seed, people=case.people), steps=case.updates)
    steps = simulated_steps(source, settings, place.map.digest)
    return Course(place.map, steps, lambda: source.kidnap(None))


def _recorded(case: Case, settings: BridgeSettings) -> Course:
    grid_map, reference = load_map(case.map), load_reference(case.reference)
    recording = open_recording(case.recording, settings)
    scans = steps_of(recording, settings, grid_map.digest)
    return Course(grid_map, _with_truth(scans, reference, case.updates), _cannot_kidnap)


def _with_truth(
    scans: Iterator[Scan], reference: Reference, updates: int | None
) -> Iterator[TrueStep]:
    for made, scan in enumerate(scans, start=1):
        pose = reference.pose_at(scan.stamp_ns)
        yield scan, None if pose is None else pose_tuple(pose)
        if made == updates:
            return


def _cannot_kidnap() -> None:
    raise ValueError("a recorded robot cannot be kidnapped")
