from pathlib import Path

from msgspec.structs import replace

from clustermcl.runtime.settings import RecorderSettings
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.source import simulated_steps
from tests.integration.alone import outcomes_of
from tests.integration.faults.system import system
from tests.integration.system.commands import ran
from tests.integration.system.conftest import SMALL
from tests.integration.system.test_same_beliefs import STEPS, assert_same_steps
from tests.integration.worlds import world_of

TAGS = replace(SMALL, bridge=replace(SMALL.bridge, source="sim:cross_tags"))


def test_tags_are_seen_through_all_processes_and_replayed(tmp_path: Path) -> None:
    """Beliefs of processes, of one process, and of the replay are the same, bit for bit."""
    recorder = RecorderSettings(folder=str(tmp_path), max_mb=5.0)
    with system(replace(TAGS, recorder=recorder), "--steps", str(STEPS)) as tested:
        beliefs = tested.wait_for_the_end()
    assert_same_steps(beliefs, outcomes_of(TAGS, steps=STEPS))
    replayed = ran("replay", str(tmp_path / TAGS.robot.name))
    assert replayed.stdout.splitlines()[-1].endswith("all as recorded, bit for bit")
    world = world_of(TAGS)
    made = list(simulated_steps(Simulation(world, TAGS.seed), TAGS.bridge, steps=STEPS))
    first = next(scan.step for scan, _ in made if scan.observations)
    assert 0 < first < STEPS - 10
    assert {belief.state for belief in beliefs[:first]} <= {"searching", "ambiguous"}
    assert beliefs[-1].state == "localized"
