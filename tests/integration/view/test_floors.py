"""The page of a building: floors as tabs, and what is drawn and said on each."""

import math
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from clustermcl.belief.outcome import belief_after
from clustermcl.evaluation.run import Case, Run, SimulatedRobot
from clustermcl.protocol.answers import SetPose
from clustermcl.protocol.steps import TruePose
from clustermcl.recordings.maps.map_message import to_message
from clustermcl.runtime.settings import Settings
from clustermcl.view.recorded_run import best_pose
from clustermcl.view.saved_page import saved_run
from tests.integration.view.page import Page, press
from tests.integration.view.stage import Stage
from tests.integration.view.test_drawn import page_of, shows
from tests.integration.waiting import wait_until

pytestmark = pytest.mark.browser

TABS = """return [...document.querySelectorAll("#floors button")].map((tab) =>
  [tab.innerText, tab.getAttribute("aria-pressed"), tab.querySelectorAll("i").length])"""


def test_floors_are_tabs_and_poses_are_those_of_the_floor_on_a_saved_page_too(
    driver: Any, tmp_path: Path
) -> None:
    case = Case(robot=SimulatedRobot(world="tower"), updates=140)
    course, steps = Run(case=case, seed=1, settings=Settings()).begun()
    floors = course.map.floors
    with Stage() as stage:
        stage.picture.on_map(to_message(course.map, "bridge"))
        page = page_of(stage, driver)
        for scan, outcome, truth in islice(steps, 140):
            assert truth is not None
            floor, there = floors.on_floor(truth)
            belief = belief_after(scan, outcome, "coordinator")
            stage.picture.on_truth(TruePose(sender="s", step=scan.step, pose=there, floor=floor))
            stage.picture.on_scan(scan)
            stage.picture.on_belief(belief)
            pose = best_pose(belief)
            stage.picture.on_pose(pose)
        shown = pose.pose
        assert shown is not None
        assert math.dist(shown[:2], there[:2]) < 0.3
        shows(stage, lambda: page.run("return liveView.view.step?.step") == 139)
        shows(stage, lambda: page.run(TABS) and page.text("x").startswith(f"{shown[0]:.2f}"))
        assert [tab[0].split()[0] for tab in page.run(TABS)] == ["ground", "first", "second"]
        tabs, best = page.run(TABS), belief.floor
        pressed = [text.split()[0] for text, is_pressed, _ in tabs if is_pressed == "true"]
        assert pressed == [best]
        (other,) = {place.floor for place in belief.hypotheses} - {best}
        assert f"place {belief.hypotheses[1].cluster}, {other}" in page.text("clusters")
        number = floors.names.index("ground")
        page.run(f"document.querySelectorAll('#floors button')[{number}].focus()")
        press(page, "\ue007")  # Enter
        page.run("liveView.travel.goTo(100)")  # the robot was in the ground floor
        shows(stage, lambda: page.run(TABS)[number][0].split()[1] == "100")
        assert page.run("return document.activeElement.innerText").startswith("ground")
        page.run("liveView.travel.toNow()")
        x, y, _ = floors.in_atlas("ground", (-4.0, -2.0, 0.0))
        left, top = page.run(f"return liveView.view.screenOf([{x}, {y}])")
        page.run("document.getElementById('set-pose').click()")
        page.drag_on_map((left, top), (left + 80, top))
        shows(stage, lambda: stage.commands)
        (command,) = stage.commands
        assert isinstance(command, SetPose)
        assert command.floor == "ground"
        assert command.pose == pytest.approx((-4.0, -2.0, 0.0), abs=0.1)
        (tmp_path / "run.html").write_text(saved_run(stage.picture))
    assert page.console() == []
    saved = Page(driver, f"{(tmp_path / 'run.html').as_uri()}#step=139")
    wait_until(lambda: saved.run(TABS) == tabs)
    assert saved.text("x").startswith(f"{shown[0]:.2f}")
    saved.run(f"document.querySelectorAll('#floors button')[{number}].click()")
    middle = saved.run("return [liveView.view.view.x, liveView.view.view.y]")
    assert floors.on_floor((*middle, 0.0))[0] == "ground"
    assert saved.console() == []
