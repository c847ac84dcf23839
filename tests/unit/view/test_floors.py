"""Recorded runs in a building: floors survive in the file, and the page draws in the atlas."""

from itertools import islice
from pathlib import Path

import msgspec

from clustermcl.belief.outcome import belief_after
from clustermcl.evaluation.course import Case, SimulatedRobot
from clustermcl.evaluation.run import Run
from clustermcl.link.metrics_of_status import StatusCollector
from clustermcl.recordings.run_log import RunLog, last_map
from clustermcl.runtime.settings import Settings
from clustermcl.view.frames import map_frame
from clustermcl.view.recorded_run import RecordedRun
from tests.unit.view.messages import status


def test_a_recorded_building_is_drawn_in_its_atlas(tmp_path: Path) -> None:
    case = Case(robot=SimulatedRobot(world="tower"), updates=3)
    course, steps = Run(case=case, seed=1, settings=Settings()).begun()
    file = tmp_path / "run.mcap"
    with RunLog(file) as log:
        log.on_map(course.map, 0)
        for scan, outcome, _ in islice(steps, 3):
            belief = belief_after(scan, outcome, "coordinator")
            log.on_scan(scan, scan.stamp_ns)
            log.on_belief(belief, scan.stamp_ns)
    assert last_map(file).floors == course.map.floors
    run = RecordedRun(file, None)
    run.read_for(60.0)
    shown = run.picture.everything()
    assert belief.floor == "ground"
    best = outcome.hypotheses[0]
    assert shown["step"]["places"][0]["pose"] == best.pose
    assert shown["pose"].pose == best.pose
    assert msgspec.to_builtins(shown["map"]["floors"])[0]["name"] == "ground"
    assert run._map is not None
    assert map_frame(run._map)["floors"] == course.map.floors.floors


def test_floors_are_metrics() -> None:
    told = msgspec.structs.replace(status(), floors={"ground": 0.9, "third": 0.1})
    samples = [s for m in StatusCollector(lambda: told, "r").collect() for s in m.samples]
    floors = {s.labels["floor"]: s.value for s in samples if "floor_probability" in s.name}
    assert floors == told.floors
