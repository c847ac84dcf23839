"""All plots of a suite of experiments."""

from collections.abc import Sequence
from pathlib import Path

from evaluation.experiments.case import ALGORITHMS, Algorithm, RecordedRobot, SimulatedRobot
from evaluation.experiments.plots import plot_probabilities, plot_reliability, plot_trajectories
from evaluation.experiments.results import ExperimentResult
from evaluation.experiments.suite import Traces
from evaluation.experiments.summary import summary
from evaluation.experiments.trace import Trace
from grid_maps.grid_map import GridMap
from grid_maps.load import load_map
from process_runtime.sources import Simulated
from robot_simulator.source import simulated_world


def draw_all(
    results: Sequence[ExperimentResult], traces: Traces, folder: Path
) -> dict[str, Sequence[Path]]:
    """Draw each experiment's first run, and the reliability of all runs together.

    Args:
        results: of the experiments.
        traces: runs to draw, by experiment and algorithm.
        folder: for the files.

    Returns:
        The files by the experiment's name; those over all experiments under the empty name.
    """
    plots: dict[str, Sequence[Path]] = {}
    for result in results:
        runs = _in_order(traces.get(result.case.name, {}))
        if runs:
            name = result.case.name
            plots[name] = (
                plot_probabilities(name, runs, folder),
                plot_trajectories(name, runs, _map_of(result.case.robot), folder),
            )
    every = {algorithm: summary(results, algorithm).estimates for algorithm in ALGORITHMS}
    parts = {algorithm: part for algorithm, part in every.items() if part.claims}
    if parts:
        plots[""] = (plot_reliability(parts, folder),)
    return plots


def _in_order(traces: dict[Algorithm, Trace]) -> dict[Algorithm, Trace]:
    """Cluster-MCL first; runs without a judged step have nothing to draw."""
    return {a: traces[a] for a in ALGORITHMS if a in traces and traces[a].steps}


def _map_of(robot: SimulatedRobot | RecordedRobot) -> GridMap:
    match robot:
        case SimulatedRobot():
            return simulated_world(Simulated(robot.world)).map
        case RecordedRobot():
            return load_map(robot.map)
