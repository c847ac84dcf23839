"""A building through all processes: beliefs, answers and commands are on its floors."""

from pathlib import Path

import pytest
from msgspec.structs import replace

from clustermcl.protocol.errors import CommandRefusedError
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.runtime.settings import RecorderSettings
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.alone import outcomes_of
from tests.integration.faults.system import system
from tests.integration.system.commands import ran
from tests.integration.system.conftest import SMALL
from tests.integration.system.test_same_beliefs import assert_same_steps
from tests.maps import write_map

STEPS = 40


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
    with system(settings, "--steps", str(STEPS)) as tested:
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
    alone = outcomes_of(settings, steps=STEPS)
    on_floors = [replace(o, hypotheses=tuple(map(floors.place, o.hypotheses))) for o in alone]
    assert_same_steps(beliefs, on_floors)
    assert (last.floor, pose.floor) == ("third", "third")
    assert pose.floors == last.floors
    assert {place.floor for place in places.hypotheses} == {h.floor for h in last.hypotheses}
    assert (given.floor, given.pose) == ("third", pytest.approx((0.0, 0.0, 0.0), abs=1e-9))
    replayed = ran("replay", str(tmp_path / settings.robot.name))
    assert replayed.stdout.splitlines()[-1].endswith("all as recorded, bit for bit")
