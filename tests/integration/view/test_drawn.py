import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from clustermcl.protocol.answers import Belief, Kidnap, Relocalize, SetPose
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.steps import Landmark, Seen, TruePose
from clustermcl.view.saved_page import saved_run
from tests.integration.view.page import Page, press, problems
from tests.integration.view.stage import Stage
from tests.integration.waiting import wait_until
from tests.unit.coordinator.reports import particles
from tests.unit.view.messages import belief, events, hypothesis, pose, scan, simulator, status

pytestmark = pytest.mark.browser


@pytest.fixture
def stage() -> Iterator[Stage]:
    with Stage() as made:
        made.show_map(120, 200)
        yield made


@pytest.fixture
def drawn(stage: Stage, driver: Any) -> Iterator[Page]:
    """The page of the stage; nothing is said on the browser's console."""
    page = page_of(stage, driver)
    yield page
    driver.get("about:blank")
    assert page.console() == []


def page_of(stage: Stage, driver: Any) -> Page:
    page = Page(driver, stage.server.link)
    shows(stage, lambda: page.run("return liveView.view.map !== null"))
    return page


def shows(stage: Stage, condition: Callable[[], object]) -> None:
    def pumped() -> object:
        stage.pump()
        return condition()

    wait_until(pumped)


def play(stage: Stage, steps: range) -> None:
    """A robot that drives along, with two places."""
    for step in steps:
        stage.picture.on_truth(TruePose(sender="s", step=step, pose=(1.0 + step / 100, 2.0, 0.0)))
        stage.picture.on_scan(scan(step, [2.0, 1.0, 0.5, 0.5]))
        stage.picture.on_belief(replace(belief(step, 1, 2), stamp_ns=step * 10**9))
        stage.picture.on_pose(pose(step))


def has_steps(stage: Stage, page: Page, count: int) -> None:
    """Wait until the page has all steps, including those skipped for speed."""
    shows(stage, lambda: [row[0] for row in page.history()] == list(range(count)))


def shown_step(page: Page) -> int | None:
    step: int | None = page.run("return liveView.view.step?.step ?? null")
    return step


def believe(stage: Stage, page: Page, what: Belief) -> None:
    stage.picture.on_belief(what)
    shows(stage, lambda: shown_step(page) == what.step)


def test_particles_are_carried_forward_by_odometry(drawn: Page) -> None:
    carried = drawn.run_async(
        "import('./particles.js').then(({carried}) => done([...carried("
        "{odom: [1, 1, Math.PI / 2], points: [300, 400, 0, 300, 400, 1571]}, [1, 3, 0])]))"
    )  # the robot has gone 2 m ahead
    assert carried == pytest.approx([5.0, 4.0, 3.0, 6.0], abs=0.01)


def test_the_scan_is_drawn_at_the_cluster_under_the_pointer(stage: Stage, drawn: Page) -> None:
    stage.picture.on_scan(scan(5, [1.5, 0.0, 0.0, 0.0]))  # 2.5 m before the robot
    believe(stage, drawn, belief(5, 1, 5))
    best, other = (place["pose"] for place in drawn.places())
    at_best, at_other = ((p[0] + 2.5 * 0.8776, p[1] + 2.5 * 0.4794) for p in (best, other))
    assert is_scan(drawn, at_best)
    assert not is_scan(drawn, at_other)
    drawn.hover_on_map(drawn.screen_of(*other[:2]))
    assert is_scan(drawn, at_other)
    assert not is_scan(drawn, at_best)


def is_scan(page: Page, where: tuple[float, float]) -> bool:
    red, green, blue = page.pixel_at(*where)
    return red > green + 80 and red > blue + 80


def test_particles_are_drawn_in_their_clusters_colour(stage: Stage, drawn: Page) -> None:
    believe(stage, drawn, belief(5, 8))  # its place is (8, 2)
    x, y = 8.0, 4.5
    assert drawn.pixel_at(x, y) == (255, 255, 255)
    stage.picture.on_particles(8, particles([(x, y, 0.0)] * 100, step=5))
    shows(stage, lambda: drawn.run("return liveView.view.clouds.size === 1"))
    red, _, blue = drawn.pixel_at(x, y)
    assert red > blue + 100  # the first colour is an orange


def test_a_ray_leads_from_the_place_to_the_landmark_that_was_seen(
    stage: Stage, drawn: Page
) -> None:
    tags = tuple(Landmark(name=f"tag {x}", x=x, y=2.0, sigma=0.1) for x in (3.0, 5.0))
    stage.show_map(121, 200, landmarks=tags)  # another map, so the page fetches it
    shows(stage, lambda: drawn.run("return liveView.view.map.frame.landmarks.length === 2"))
    flat = (0.01, 0.0, 0.0, 0.01)
    seen = Seen(landmark="tag 3.0", mean=(2.0, 0.0), covariance=flat, outlier_probability=0.05,
                share=1.0)  # fmt: skip
    stage.picture.on_scan(replace(scan(5, [0.0] * 4), observations=(seen,)))
    believe(stage, drawn, belief(5, 8))
    half_way = [(8.0 + 0.8776, 2.0 + 0.4794 + off) for off in (-0.01, 0.0, 0.01)]  # a thin line
    assert any(is_scan(drawn, where) for where in half_way)
    assert is_scan(drawn, (3.0, 2.0)), "a landmark that was seen has the colour of the scan"
    red, green, _ = drawn.pixel_at(5.0, 2.0)
    assert red == green or red < 60, "a landmark that was not seen is dark"


def test_the_page_looks_back_and_returns_to_now(stage: Stage, drawn: Page) -> None:
    stage.picture.on_events(events(3))
    stage.picture.on_status(status())
    play(stage, range(20))
    stage.picture.on_events(events(15))
    has_steps(stage, drawn, 20)
    drawn.click("set-pose")
    assert drawn.is_visible("hint")
    press(drawn, ",")
    shows(stage, lambda: shown_step(drawn) == 18)
    assert not drawn.is_visible("hint"), "a pose is given for now only"
    drawn.run("liveView.connection.socket.close(); liveView.travel.goTo(7)")
    shows(stage, lambda: shown_step(drawn) == 7)  # asked for when it is connected again
    assert drawn.run("return location.hash") == "#step=7"
    assert drawn.text("announced") == "ambiguous, looking back"  # once, also while it plays
    assert drawn.text("slider-step") == "step 7"
    assert drawn.text("clock") == "0:07"
    assert drawn.run("return liveView.view.rows.length") == 8
    assert "0:00 place 3 found" in " ".join(drawn.text("events").split())
    assert "place 15" not in drawn.text("events")
    assert drawn.run("return liveView.view.step.scan.length") == 8
    play(stage, range(20, 23))
    shows(stage, lambda: drawn.history()[-1][0] == 22)
    assert shown_step(drawn) == 7  # what goes on meanwhile does not disturb
    drawn.click("play")
    shows(stage, lambda: drawn.run("return liveView.travel.at === null"))
    assert shown_step(drawn) == 22
    assert drawn.run("return location.hash") == ""
    shows(stage, lambda: "place 15" in drawn.text("events"))
    press(drawn, ",")
    believe(stage, drawn, belief(0, 1))  # the system begins again, and so does the page


def test_what_arrives_while_a_map_is_fetched_is_shown_after_it(stage: Stage, drawn: Page) -> None:
    drawn.run("const now = fetch, later = new Promise((done) => setTimeout(done, 500));"
              "window.fetch = (...what) => later.then(() => now(...what))")  # fmt: skip
    before = drawn.section()
    stage.show_map(121, 200)
    for step in (0, 1):
        stage.picture.on_belief(belief(step, 1))
        stage.pump()
    shows(stage, lambda: drawn.run("return liveView.view.map.frame.rows === 121"))
    assert shown_step(drawn) == 1
    assert drawn.section() != before, "the map has another size, so it is fitted again"


def test_a_link_to_a_step_opens_that_step(stage: Stage, drawn: Page) -> None:
    play(stage, range(4000))
    has_steps(stage, drawn, 4000)
    drawn.driver.get("about:blank")
    drawn.driver.get(f"{stage.server.link}#step=42")
    shows(stage, lambda: shown_step(drawn) == 42)
    shows(stage, lambda: len(drawn.run("return liveView.view.rows")) == 43)  # its trails come first
    drawn.run("document.getElementById('plot').dispatchEvent("
              "new MouseEvent('click', {clientX: 0, bubbles: true}))")  # fmt: skip
    shows(stage, lambda: shown_step(drawn) == 0)  # its left end: the plot is of that time
    has_steps(stage, drawn, 4000)  # all others come afterwards, also those skipped for speed
    drawn.driver.get("about:blank")
    drawn.driver.get(f"{stage.server.link}#step=9999")  # which is not kept
    shows(stage, lambda: shown_step(drawn) == 3999)


def test_the_simulated_robot_is_kidnapped(stage: Stage, drawn: Page) -> None:
    believe(stage, drawn, belief(0, 1))
    assert not drawn.is_visible("kidnap")  # a real robot is not lifted
    play(stage, range(1, 4))
    shows(stage, lambda: shown_step(drawn) == 3)
    stage.picture.on_status(status())
    shows(stage, lambda: drawn.text("worker-count") == "2")
    assert not drawn.is_visible("kidnap")  # a recording with a reference has a true pose, too
    assert not drawn.is_visible("sources")
    stage.picture.on_status(status(processes=(simulator(),)))
    shows(stage, lambda: drawn.is_visible("kidnap"))
    assert drawn.text("sources") == "eye exit\n70 % false"
    drawn.run("for (const repeat of [false, true]) document.dispatchEvent("
              "new KeyboardEvent('keydown', {key: 'k', repeat}))")  # fmt: skip
    press(drawn, "k")  # for the second time: before, it was held
    shows(stage, lambda: [type(one) for one in stage.commands] == [Kidnap])
    drawn.click("kidnap")
    start = drawn.screen_of(3.0, 3.0)
    drawn.drag_on_map(start, (start[0], start[1] - 50))
    shows(stage, lambda: len(stage.commands) == 2)
    lifted = stage.commands[1]
    assert isinstance(lifted, Kidnap)
    assert lifted.pose == pytest.approx((3.0, 3.0, 1.57), abs=0.05)


def test_set_pose_asks_for_its_uncertainty(stage: Stage, drawn: Page) -> None:
    drawn.click("set-pose")
    drawn.hover_on_map(drawn.screen_of(3.0, 3.0))
    before = drawn.section()
    drawn.actions().context_click().click_and_hold().move_by_offset(50, 0).perform()
    press(drawn, "--")  # narrower
    assert drawn.text("hint") == "± 0.30 m"
    drawn.actions().release().perform()
    shows(stage, lambda: stage.commands)
    (given,) = stage.commands
    assert isinstance(given, SetPose)
    assert given.pose == pytest.approx((3.0, 3.0, 0.0), abs=0.05)
    assert given.position_sigma_m == pytest.approx(0.5 / 1.3**2)
    assert drawn.section() == before  # the map stays


def many_places(step: int) -> Belief:
    """All over the map."""
    reported = belief(step, *range(64))
    places = [
        replace(
            place,
            pose=(0.7 + 1.2 * (i * 5 % 8) + step / 50, 0.6 + 0.65 * (i // 8), i / 9),
        )
        for i, place in enumerate(reported.hypotheses)
    ]
    return replace(reported, hypotheses=tuple(places))


def test_a_run_that_was_saved_plays_without_a_server(
    stage: Stage, driver: Any, tmp_path: Path
) -> None:
    play(stage, range(1200))
    stage.picture.on_events(events(*range(150)))
    stage.picture.on_link("finished")
    file = tmp_path / "run.html"
    file.write_text(saved_run(stage.picture))
    page = Page(driver, f"{file.as_uri()}#step=4")
    wait_until(lambda: shown_step(page) == 4)
    truth = page.run("return liveView.view.step.truth")
    assert truth == pytest.approx([1.04, 2.0, 0.0])
    assert [row[0] for row in page.history()] == list(range(1200))
    assert "place 4 found" in page.text("events")
    page.run("liveView.travel.goTo(1190)")
    page.click("play")
    wait_until(lambda: shown_step(page) == 1199)
    wait_until(lambda: page.text("slider-step") == "end")
    assert page.console() == []


OVERLAPS = """
const ids = ["actions", "caption", "hint", "toolbar", "legend", "timeline"];
const boxes = ids.map((id) => [id, document.getElementById(id).getBoundingClientRect()]);
return boxes.flatMap(([id, box], i) => boxes.slice(i + 1).filter(([, other]) =>
  box.left < other.right && other.left < box.right
  && box.top < other.bottom && other.top < box.bottom
).map(([other]) => `${id} and ${other}`));
"""


def test_a_row_of_the_list_is_chosen_by_keyboard_and_keeps_the_focus(
    stage: Stage, drawn: Page
) -> None:
    stage.picture.on_belief(replace(belief(1, 4, 7), elsewhere_probability=0.25))
    shows(stage, lambda: len(drawn.run(ROWS)) == 2)
    assert re.search(r"elsewhere\s+25 %", drawn.text("clusters"))
    drawn.run("document.querySelector('#clusters li[data-cluster=\"7\"] button').focus()")
    press(drawn, "\ue007")  # Enter
    assert drawn.run("return liveView.view.selected") == 7
    stage.picture.on_belief(belief(2, 7, 4))
    shows(stage, lambda: drawn.run(ROWS)[0] == "7")
    assert drawn.run("return document.activeElement.closest('li').dataset.cluster") == "7"
    drawn.actions().click_and_hold(drawn.driver.switch_to.active_element).perform()
    stage.picture.on_belief(belief(3, 7, 4))
    shows(stage, lambda: drawn.text("step") == "3")
    drawn.actions().release().perform()
    assert drawn.run("return liveView.view.selected") is None, "pressed again, as steps went on"


ROWS = """
return [...document.querySelectorAll("#clusters li[data-cluster]")].map((r) => r.dataset.cluster);
"""


def test_a_click_on_a_place_colours_its_beams_by_class(stage: Stage, drawn: Page) -> None:
    """It looks along the wall of a room of 10 m by 6 m, from (1, 2) to the right."""
    straight = replace(hypothesis(1, 0.9), pose=(1.0, 2.0, 0.0))
    beams = [7.95, 20.0, 7.95, 1.0]  # ahead to the wall; then left, back and right
    seen = replace(scan(5, beams), range_max_m=30.0)
    stage.picture.on_scan(seen)
    believe(stage, drawn, replace(belief(5, 1), hypotheses=(straight,)))
    assert not drawn.is_visible("beams")
    x, y = drawn.screen_of(1.0, 2.0)
    drawn.drag_on_map((x, y), (x, y))
    shows(stage, lambda: drawn.is_visible("beams"))
    legend = drawn.text("beams")
    assert "1 hit" in legend
    assert "2 through a wall" in legend
    assert "1 short of one" in legend
    press(drawn, "\ue00c")  # Esc
    shows(stage, lambda: not drawn.is_visible("beams"))


NOWHERE = {"hypotheses": (), "searching": True}


@pytest.mark.parametrize(("believed", "answered", "facts"), [
    ({"state": "searching", "search_progress": 0.4, **NOWHERE}, {"pose": None},
     {"state": "searching", "probability": "–", "announced": "searching"}),
    ({"hypotheses": belief(5, *range(64)).hypotheses}, {"probability": 0.09},
     {"state": "ambiguous, 64 places", "probability": "9.0 %", "freshness": "0."}),
    ({"state": "localized"}, {"probability": 0.912, "pose": (-0.001, 2.0, 0.5)},
     {"state": "localized", "probability": "91 %", "now": "x\n0.00 m"}),
    ({"state": "lost", "elsewhere_probability": 0.93, "off_map_probability": 0.6, **NOWHERE}, {},
     {"state": "lost", "of": "probably not on this map"}),
    ({"state": "localized"}, {"freshness": "stale", "age_s": 42.0},
     {"state": "stale", "of": "last known: localized", "freshness": "42 s old"}),
    ({"state": "lost"}, {"freshness": "dead_reckoning", "workers": 0},
     {"state": "dead reckoning", "banner": "No worker is alive",
      "announced": "dead reckoning, last known: lost"}),
    ({"state": "localized", "last": True}, {},
     {"state": "localized", "freshness": "the run has ended"}),
])  # fmt: skip
def test_the_head_of_the_page_names_the_state(
    stage: Stage,
    drawn: Page,
    believed: dict[str, Any],
    answered: dict[str, Any],
    facts: dict[str, str],
) -> None:
    assert drawn.run("return document.getElementById('announced').role") == "status"
    stage.picture.on_belief(replace(belief(5, 1, 2), **believed))
    answer = pose(5, state=believed.get("state", "ambiguous"), **answered)
    stage.picture.on_status(status(workers={} if answer.workers == 0 else {"w-0": ("c1",)}))

    def is_shown() -> bool:
        stage.picture.on_pose(answer)  # else it is stale after three seconds
        return all(fact in drawn.text(name) for name, fact in facts.items())

    shows(stage, is_shown)


@pytest.mark.parametrize("screen", ["dark", "390x844"])
@pytest.mark.parametrize("shown", ["past", "dead_reckoning", "waiting", "keys"])
def test_axe_finds_nothing(stage: Stage, drawn: Page, screen: str, shown: str) -> None:
    """Contrast, names and roles, with so many places and events that their lists scroll."""
    for step in range(20):
        stage.picture.on_belief(many_places(step))
        stage.picture.on_pose(pose(step))
    stage.picture.on_events(events(*range(20)))
    stage.picture.on_status(status(processes=(simulator(),)))
    has_steps(stage, drawn, 20)
    with drawn.on_screen(screen):
        match shown:
            case "past":
                drawn.run("liveView.travel.goTo(7)")
                shows(stage, lambda: shown_step(drawn) == 7)
            case "dead_reckoning":
                stage.picture.on_pose(pose(19, freshness="dead_reckoning", workers=0))
                stage.picture.on_status(status(workers={}))
                shows(stage, lambda: drawn.text("state") == "dead reckoning")
            case "waiting":
                stage.picture.on_link("no system")
                shows(stage, lambda: drawn.is_visible("banner"))
            case "keys":
                press(drawn, "?")
                assert "kidnap" in drawn.text("keys")
        assert problems(drawn) == []
        assert not drawn.run(OVERLAPS), "no element of the page covers another"
        assert not drawn.run("return document.documentElement.scrollWidth > innerWidth")


def test_a_demo_shows_its_captions(stage: Stage, drawn: Page) -> None:
    believe(stage, drawn, belief(1, 1, 2))
    assert not drawn.is_visible("caption")  # only of a demo
    drawn.run("liveView.take({system: {...liveView.system, story: 'sim'}})")

    def shows_text(step: int, text: str, **changed: Any) -> None:
        stage.picture.on_belief(replace(belief(step, 1, 2), **changed))
        shows(stage, lambda: text in drawn.text("caption"))

    shows_text(2, "Two places are possible")
    assert not drawn.is_visible("again")
    with drawn.on_screen("320x568"):
        shows(stage, lambda: drawn.section()["scale"] > 12)  # there is room for the map
    shows_text(6, "fits one place alone", state="localized")
    drawn.click("again")
    shows(stage, lambda: [type(one) for one in stage.commands] == [Relocalize])
    shows_text(7, "The run has ended", last=True)
    drawn.click("again")
    shows(stage, lambda: (shown_step(drawn) or 9) < 7)  # it is played from the first step
    assert [type(one) for one in stage.commands] == [Relocalize]


def test_changes_are_a_layer_with_a_reading_of_each_cell(stage: Stage, drawn: Page) -> None:
    digest = drawn.run("return liveView.view.map.frame.digest")
    cells = ArrayBlob.of([[10 * 100 + 20, 0, 7, 1], [10 * 100 + 40, 1, 9, 1]], "int32")
    times_s = ArrayBlob.of([[0.0, 60.0], [0.0, 100.0]], "float64")
    seen = Changes(
        sender="b", map_digest=digest, stamp_ns=100 * 10**9, cell_m=0.1, rows=60, cols=100,
        map_from_grid=(0.0, 0.0, 0.0), cells=cells, times_s=times_s,
    )  # fmt: skip
    assert drawn.run("return document.querySelector('[data-layer=changes]').hidden")
    stage.picture.on_changes(seen)
    shows(stage, lambda: drawn.run("return liveView.view.changes?.cells.length === 2"))

    def says(x: float, y: float) -> str:
        text: str = drawn.run_async(
            f"import('./changes.js').then((c) => done(c.changeAt(liveView.view, [{x}, {y}])))"
        )
        return text

    gone, new = (2.05, 1.05), (4.05, 1.05)
    red, blue = (drawn.pixel_at(*at) for at in (gone, new))
    assert red[0] > red[2] + 50
    assert blue[2] > blue[0] + 50
    assert says(*gone) == "  gone: seen 7 times in 60 s, last 40 s ago"
    assert says(3.0, 1.05) == ""
    drawn.driver.find_element("css selector", "[data-layer=changes]").click()
    assert drawn.pixel_at(*gone) != red
    assert says(*gone) == ""
