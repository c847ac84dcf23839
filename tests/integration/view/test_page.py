"""The page in a real browser, on a real system. The tests follow one another, as a person would."""

import math
from collections.abc import Iterator

import pytest

from tests.integration.view.conftest import System
from tests.integration.view.page import Page
from tests.integration.waiting import wait_until

pytestmark = pytest.mark.browser


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
    running.wait_for_places(4)
    wait_until(lambda: len(running.history()) > 20)  # the first search is over
    running.click("advise")
    wait_until(lambda: running.run("return liveView.view.advice.length") >= 4)
    assert running.text("hint")


def test_an_arrow_dragged_on_the_map_sets_the_pose(running: Page, system: System) -> None:
    wait_until(running.places)
    running.click("set-pose")
    dropped = running.places()[-1]["pose"]  # the least probable
    x, y = running.screen_of(*dropped[:2])
    nose = (x + 60 * math.cos(dropped[2]), y - 60 * math.sin(dropped[2]))
    running.drag_on_map((x, y), nose)
    wait_until(lambda: "given" in system.causes())
    wait_until(lambda: "given by a command" in running.text("events"))
    wait_until(lambda: probability_near(running, dropped) > 0.5)
    assert running.text("hint") in ("", "done")


def test_an_arrow_dragged_off_the_map_is_refused_with_a_sentence(running: Page) -> None:
    running.click("fit")
    running.click("set-pose")
    width = running.run("return liveView.view.canvas.clientWidth")
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
