"""The same run in this process, without Zenoh, and beliefs held against it."""

from collections.abc import Iterable

from clustermcl.belief.outcome import Outcome
from clustermcl.coordinator.process import filter_settings
from clustermcl.jobs import in_process
from clustermcl.jobs.map_model import sensor_model
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.steps import Scan
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.runtime.settings import Settings
from clustermcl.simulator.simulation import Simulation, simulated_steps
from tests.integration.worlds import world_of


def outcomes_of(settings: Settings, *, steps: int) -> list[Outcome]:
    world = world_of(settings)
    made = simulated_steps(Simulation(world, settings.seed), settings.bridge, steps=steps)
    return outcomes_of_scans((scan for scan, _ in made), world.map, settings)


def outcomes_of_scans(
    scans: Iterable[Scan], grid_map: GridMap, settings: Settings
) -> list[Outcome]:
    model = sensor_model(grid_map, settings.sensor, cache_folder=None)
    found = in_process.outcomes(scans, model, filter_settings(settings))
    return [outcome for _, outcome in found]


def assert_same(beliefs: Iterable[Belief], alone: Iterable[Outcome]) -> None:
    """Every received belief, repeated ones included, equals that of one process, bit for bit."""
    expected = {outcome.step: outcome for outcome in alone}
    for belief in beliefs:
        assert belief.missing == (), f"step {belief.step}"
        for name in ("hypotheses", "state", "searching", "off_map_probability"):
            ours, theirs = getattr(belief, name), getattr(expected[belief.step], name)
            assert ours == theirs, f"{name} of step {belief.step}"
