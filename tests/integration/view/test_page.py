"""The page in a real browser, on a real system. The tests follow one another, as a person would."""

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.integration.view.conftest import System
from tests.integration.view.page import Page, Snapshot, press
from tests.integration.waiting import wait_until

pytestmark = pytest.mark.browser

STATIC = Path(__file__).parents[3] / "clustermcl" / "view" / "static"
NEAR_M = 0.6
"""A cluster of few particles trails the robot by less."""


@pytest.fixture(autouse=True)
def quiet_console(page: Page) -> Iterator[None]:
    """Nothing is said on the browser's console: no error, no refused resource."""
    yield
    assert page.console() == []


@pytest.fixture
def running(system: System, page: Page) -> Page:
    if page.system != "running":
        system.start()
        wait_until(lambda: page.system == "running")
    return page


def colours(file: str, pattern: str) -> list[tuple[int, int, int]]:
    found = re.findall(pattern, (STATIC / file).read_text())
    return [(int(c[0:2], 16), int(c[2:4], 16), int(c[4:6], 16)) for c in found]


PALETTE = colours("palette.js", r'"#([0-9A-F]{6})"')


def test_without_a_system_the_page_shows_that_it_waits(page: Page) -> None:
    wait_until(lambda: page.system == "no router")
    assert page.is_visible("banner")
    assert "waiting for the system" in page.text("banner-text")
    assert page.text("state") == "waiting"


def test_the_page_finds_a_system_that_is_started_after_it(running: Page) -> None:
    wait_until(lambda: not running.is_visible("banner"))  # workers may be starting
    wait_until(lambda: running.run("return liveView.view.map !== null"))  # it has just begun
    wait_until(lambda: running.text("worker-count") == "2")
    running.driver.find_element("css selector", "#system summary").click()


def test_four_clusters_stand_in_four_colours_where_they_are(running: Page, pictures: Path) -> None:
    running.wait_for_places(4)
    taken: list[Snapshot] = []

    def stand_in_four_arms() -> bool:
        taken.append(running.snapshot())
        is_late = running.run("return liveView.view.faded")  # on a busy machine
        return not is_late and in_four_arms(taken[-1])

    wait_until(stand_in_four_arms)
    running.save(pictures / "four.png")
    places = probable(taken[-1])
    assert len({place["slot"] for place in places}) == 4
    for place in places:
        assert taken[-1].pixel_at(*place["pose"][:2]) == PALETTE[place["slot"]]


def test_advice_is_answered_and_drawn_from_each_place(running: Page) -> None:
    running.wait_for_places(4)
    running.click("advise")
    wait_until(lambda: "cannot be distinguished" in running.text("hint"))
    assert running.run("return liveView.view.advice.length") >= 4
    way = {
        "poses": [[0, 0, 0], [0.5, 0, 0], [1, 0, 0]], "length_m": 1, "information": 0.5,
        "sure_probability": 0.2, "rest": [[1, 0.8, 0]],
    }  # fmt: skip
    running.run(
        "const [one] = liveView.view.advice; liveView.usual = liveView.view.layers;"
        f"one.ways = [{json.dumps(way)}]; one.pose = [0.5, 0, 0]; one.slot = 5;"
        "one.spots = [[0, -1, 0], [1, -1, 0.3]];"
        "liveView.view.layers = new Set(['map']); liveView.view.redraw()"
    )
    wait_until(lambda: running.snapshot().pixel_at(1.5, 0.0) == PALETTE[5])
    drawn = running.snapshot()
    assert is_tinted(drawn.pixel_at(1.5, -1.0))
    assert not is_tinted(drawn.pixel_at(0.5, -1.0))  # a spot without information
    on_rest = [is_tinted(drawn.pixel_at(1.5, 0.3 + 0.01 * i)) for i in range(40)]
    assert any(on_rest)
    assert not all(on_rest)  # dotted
    running.run("liveView.view.advice = []; liveView.view.layers = liveView.usual")


def is_tinted(pixel: tuple[int, int, int]) -> bool:
    return max(pixel) - min(pixel) > 20


def probable(snapshot: Snapshot) -> list[dict[str, Any]]:
    return [place for place in snapshot.step["places"] if place["p"] > 0.04]


def in_four_arms(snapshot: Snapshot) -> bool:
    """Whether each arm of the cross has a place like the true one, and none hides another."""
    places, truth = probable(snapshot), snapshot.step["truth"]
    if len(places) != 4 or truth is None:
        return False
    everywhere = snapshot.step["places"]
    nearest_m = min(apart(place, other) for place in places for other in everywhere)
    x, y, _ = truth
    arms = [(x, y), (-y, x), (-x, -y), (y, -x)]
    return nearest_m * snapshot.view["scale"] > 60 and all(
        any(math.dist(place["pose"][:2], arm) < NEAR_M for place in places) for arm in arms
    )


def apart(place: dict[str, list[float]], other: dict[str, list[float]]) -> float:
    if place is other:
        return math.inf
    return math.dist(place["pose"][:2], other["pose"][:2])


def test_an_arrow_dragged_on_the_map_sets_the_pose(running: Page, system: System) -> None:
    wait_until(lambda: running.snapshot().step["places"])
    running.click("set-pose")
    snapshot = running.snapshot()
    dropped = snapshot.step["places"][-1]["pose"]  # the least probable
    x, y = snapshot.screen_of(*dropped[:2])
    nose = (x + 60 * math.cos(dropped[2]), y - 60 * math.sin(dropped[2]))
    running.drag_on_map((x, y), nose)
    wait_until(lambda: "given" in system.causes())
    wait_until(lambda: "given by a command" in running.text("events"))
    wait_until(lambda: probability_near(running, dropped) > 0.5)
    assert running.text("hint") in ("", "done")


def test_an_arrow_dragged_off_the_map_is_refused_with_a_sentence(running: Page) -> None:
    running.click("fit")
    running.click("set-pose")
    width, _ = running.snapshot().size
    running.drag_on_map((width - 60, 300), (width - 20, 300))
    wait_until(lambda: running.text("hint") not in ("", "done") and running.is_visible("hint"))
    assert running.run("return document.getElementById('hint').className") == "bad"
    assert "free ground" in running.text("hint")


def probability_near(page: Page, pose: list[float]) -> float:
    """The most that was held of a place near a pose in the last steps."""
    places = [place for row in page.history()[-30:] for place in row[1]]
    return max((p[2] for p in places if math.dist(p[3:5], pose[:2]) < 1.5), default=0.0)


def test_relocalize_asks_first_and_then_searches(running: Page, system: System) -> None:
    requested = system.causes().count("search requested")
    running.click("relocalize")
    assert running.is_visible("confirm")
    running.click("confirm-no")
    assert not running.is_visible("confirm")
    assert system.causes().count("search requested") == requested
    running.click("relocalize")
    running.click("confirm-yes")
    wait_until(lambda: system.causes().count("search requested") > requested)
    wait_until(lambda: "search requested: by view" in running.text("events"))


def test_keys_zoom_pan_fit_and_follow(running: Page) -> None:
    def pressed(keys: str) -> dict[str, float]:
        press(running, keys)
        return running.snapshot().view

    fitted = pressed("f")
    assert pressed("++")["scale"] == pytest.approx(fitted["scale"] * 1.3**2)
    assert pressed("\ue014")["x"] > fitted["x"]  # the right arrow
    assert pressed("f") == fitted
    pressed("l")
    assert running.run("return liveView.view.follow")
    pressed("f")
    assert not running.run("return liveView.view.follow")


def test_the_page_survives_a_restart_of_the_system(running: Page, system: System) -> None:
    wait_until(lambda: len(running.history()) > 20)
    before = running.history()[-1][0]
    system.stop()
    wait_until(lambda: running.system == "no router")
    assert running.is_visible("banner")
    assert running.history()[-1][0] >= before  # the last picture stays
    system.start()
    wait_until(lambda: running.system == "running")
    wait_until(lambda: len(running.history()) > 0 and running.history()[-1][0] < before)
    wait_until(lambda: not running.is_visible("banner"))
