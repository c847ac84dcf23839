import os
import signal
from itertools import groupby
from pathlib import Path

import pytest
from msgspec.structs import replace

from clustermcl.belief.outcome import Outcome
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.errors import CommandRefusedError
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.runtime.settings import RecorderSettings
from clustermcl.simulator.simulation import Simulation, simulated_steps
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.alone import assert_same, outcomes_of
from tests.integration.faults.system import system
from tests.integration.system.commands import ran
from tests.integration.system.conftest import SMALL
from tests.integration.waiting import wait_until
from tests.integration.worlds import world_of
from tests.maps import write_map

STEPS = 60


def assert_same_steps(beliefs: list[Belief], alone: list[Outcome]) -> None:
    """Every step has a belief, which a busy machine may repeat, and it is that of one process."""
    steps = [step for step, _ in groupby(belief.step for belief in beliefs)]
    assert steps == [outcome.step for outcome in alone]
    assert_same(beliefs, alone)


def test_a_decoy_changes_the_belief_in_processes_as_it_does_in_one() -> None:
    """A robot that is probably not on the map has one at once; it is searched for and tracked."""
    doubting = replace(SMALL, belief=replace(SMALL.belief, off_map_probability=0.6))
    alone = outcomes_of(doubting, steps=STEPS)
    jobs = {job_id for outcome in alone for job_id in outcome.begin}
    assert {"m0.0", "d0"} <= jobs
    with system(doubting, "--steps", str(STEPS)) as tested:
        assert_same_steps(tested.wait_for_the_end(), alone)


def test_workers_that_are_killed_change_no_belief_of_a_robot_that_sees_tags(tmp_path: Path) -> None:
    """One is killed, then two, then all: their clusters continue from snapshots.

    Beliefs of processes, of one process, and of the replay are the same, bit for bit.
    """
    tags = replace(SMALL, bridge=replace(SMALL.bridge, source="sim:cross_tags"))
    recorder = RecorderSettings(folder=str(tmp_path), max_mb=5.0)
    with system(replace(tags, recorder=recorder), "--steps", str(STEPS)) as tested:
        for step, count in ((15, 1), (27, 2), (41, 4)):
            wait_until(lambda s=step: tested.step >= s)  # type: ignore[misc] # a default
            for pid in tested.worker_pids()[:count]:
                os.kill(pid, signal.SIGKILL)
        beliefs = tested.wait_for_the_end()
    assert_same_steps(beliefs, outcomes_of(tags, steps=STEPS))
    replayed = ran("replay", str(tmp_path / tags.robot.name))
    assert replayed.stdout.splitlines()[-1].endswith("all as recorded, bit for bit")
    world = world_of(tags)
    made = simulated_steps(Simulation(world, tags.seed), tags.bridge, steps=STEPS)
    first = next(scan.step for scan, _ in made if scan.observations)
    assert 0 < first < STEPS - 10
    assert {belief.state for belief in beliefs if belief.step < first} <= {"searching", "ambiguous"}
    assert beliefs[-1].state == "localized"


def test_a_building_goes_through_all_processes_and_is_replayed(tmp_path: Path) -> None:
    for name in ("cross", "hall"):
        write_map(world(name).map, tmp_path, name)
    building = tmp_path / "building.yaml"
    building.write_text("floors: {ground: cross.yaml, third: {map: hall.yaml, height_m: 8}}\n")
    settings = replace(
        SMALL,
        bridge=replace(SMALL.bridge, source=f"sim:{building}"),
        recorder=RecorderSettings(folder=str(tmp_path), max_mb=5.0),
    )
    floors = load_map(building).floors
    with system(settings, "--steps", "40") as tested:
        beliefs = tested.wait_for_the_end()
        with tested.client as client:
            assert client.map().floors == floors
            pose, places = client.pose(), client.hypotheses()
            assert client.status().floors == pose.floors
            with pytest.raises(CommandRefusedError, match="name a floor"):
                client.set_pose((0.0, 0.0, 0.0))
            client.set_pose((0.0, 0.0, 0.0), floor="third")
            given = client.pose()
    last = beliefs[-1]
    alone = outcomes_of(settings, steps=40)
    on_floors = [replace(o, hypotheses=tuple(map(floors.place, o.hypotheses))) for o in alone]
    assert_same_steps(beliefs, on_floors)
    assert (last.floor, pose.floor) == ("third", "third")
    assert pose.floors == last.floors
    assert {place.floor for place in places.hypotheses} == {h.floor for h in last.hypotheses}
    assert (given.floor, given.pose) == ("third", pytest.approx((0.0, 0.0, 0.0), abs=1e-9))
    replayed = ran("replay", str(tmp_path / settings.robot.name))
    assert replayed.stdout.splitlines()[-1].endswith("all as recorded, bit for bit")
