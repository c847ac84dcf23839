"""Ten states of the page in four windows, light and dark, recognisable at a glance.

The pictures go to BROWSER_PICTURES, for a person to look at.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from clustermcl.belief.outcome import belief_after
from clustermcl.filter.settings import FilterSettings
from clustermcl.jobs.in_process import outcomes
from clustermcl.jobs.map_model import sensor_model
from clustermcl.protocol.answers import Belief, PoseAnswer
from clustermcl.protocol.steps import Scan, TruePose
from clustermcl.recordings.maps.map_message import to_message
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.source import simulated_steps
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.view.stage import Stage
from tests.integration.view.test_drawn import many_places, page_of, shows
from tests.unit.view.messages import events, pose, simulator, status

pytestmark = pytest.mark.browser

CROSS = world("cross_feature")
AMBIGUOUS_AT, LOCALIZED_AT = 100, 170
WINDOWS = ("320x700", "768x1024", "1280x800", "2560x1440")

Step = tuple[Scan, TruePose, Belief]


@pytest.fixture(scope="module")
def steps() -> list[Step]:
    """The demo's run: four arms look alike until the robot sees the cabinet."""
    settings = FilterSettings()
    simulation, count = Simulation(CROSS, settings.seed), LOCALIZED_AT + 2
    made = list(simulated_steps(simulation, BridgeSettings(), steps=count))[:-1]
    model = sensor_model(CROSS.map, settings.sensor, cache_folder=None)
    found = []
    for (scan, truth), (_, outcome) in zip(
        made, outcomes((scan for scan, _ in made), model, settings), strict=True
    ):
        at = TruePose(sender="s", step=scan.step, pose=truth)
        found.append((scan, at, belief_after(scan, outcome, "coordinator")))
    return found


@pytest.fixture
def stage() -> Iterator[Stage]:
    with Stage() as made:
        made.show(to_message(CROSS.map, "bridge"))
        yield made


def drive(stage: Stage, steps: list[Step], **changed: Any) -> PoseAnswer:
    for scan, truth, belief in steps:
        best = belief.hypotheses[0] if belief.hypotheses else None
        usual = {
            "state": belief.state,
            "probability": best.probability if best else 0.0,
            "pose": best.pose if best else None,
            "covariance": best.covariance if best else None,
            "elsewhere_probability": belief.elsewhere_probability,
            "off_map_probability": belief.off_map_probability,
        }
        answer = pose(belief.step, **{**usual, **changed})
        stage.picture.on_truth(truth)
        stage.picture.on_scan(scan)
        stage.picture.on_belief(belief)
        stage.picture.on_pose(answer)
    stage.picture.on_events(events(1, 2, 40))
    processes = (simulator(),) if changed.get("workers", 1) else ()
    workers = {} if processes else {"workers": {}}
    stage.picture.on_status(status(digest=CROSS.map.digest, processes=processes, **workers))
    return answer


SEARCHING = {"state": "searching", "hypotheses": (), "searching": True, "search_progress": 0.4}
LOST = {
    "state": "lost", "hypotheses": (), "searching": True, "search_progress": 0.2,
    "elsewhere_probability": 0.93, "off_map_probability": 0.6,
}  # fmt: skip
MANY = {"state": "ambiguous", "hypotheses": many_places(0).hypotheses}


GLANCE = """
const seen = ["state", "of", "freshness", "probability", "banner", "map", "link"].filter((id) => {
  const one = document.getElementById(id), {left, right, top, bottom} = one.getBoundingClientRect();
  return one.checkVisibility() && one.scrollWidth <= one.clientWidth + 1
    && left >= 0 && right <= innerWidth && top >= 0 && bottom <= innerHeight;
});
return Object.fromEntries(seen.map((id) => [id, document.getElementById(id).innerText]));
"""


WEIGHT = "return getComputedStyle(document.getElementById('probability')).fontWeight"

COLLISIONS = """
return [...document.querySelectorAll("#now dd, #clusters .more")].filter((one) =>
  one.checkVisibility() && (one.scrollWidth > one.clientWidth || one.clientHeight > 45)
).map((one) => one.innerText);
"""


@pytest.mark.parametrize(("state", "last", "believed", "answered", "facts"), [
    ("waiting", None, {}, {}, {"banner": "no coordinator localizes"}),
    ("searching", 0, SEARCHING, {},
     {"state": "searching", "probability": "–", "freshness": "0."}),
    ("ambiguous", AMBIGUOUS_AT, {}, {},
     {"state": "ambiguous, 4 places", "probability": "2", "freshness": "0."}),
    ("many", 0, MANY, {},
     {"state": "ambiguous, 64 places", "probability": "9.0 %", "freshness": "0."}),
    ("localized", LOCALIZED_AT, {}, {},
     {"state": "localized", "probability": "91 %", "freshness": "0."}),
    ("lost", LOCALIZED_AT, LOST, {},
     {"state": "lost", "of": "probably not on this map", "freshness": "0."}),
    ("stale", LOCALIZED_AT, {}, {"freshness": "stale", "age_s": 42.0},
     {"state": "stale", "of": "last known: localized", "freshness": "42 s old"}),
    ("dead_reckoning", LOCALIZED_AT, {}, {"freshness": "dead_reckoning", "workers": 0},
     {"state": "dead reckoning", "of": "last known: localized", "banner": "No worker is alive"}),
    ("past", LOCALIZED_AT, {}, {},
     {"state": "ambiguous, 4 places", "freshness": "before now"}),
    ("ended", LOCALIZED_AT, {"last": True}, {},
     {"state": "localized", "freshness": "the run has ended"}),
])  # fmt: skip
def test_state_places_probability_and_freshness_are_visible_without_scrolling(
    stage: Stage, steps: list[Step], driver: Any, pictures: Path, state: str, last: int | None,
    believed: dict[str, Any], answered: dict[str, Any], facts: dict[str, str],
) -> None:  # fmt: skip
    page = page_of(stage, driver)
    answer = None
    if last is None:
        stage.picture.on_link("no system")
    else:
        scan, truth, belief = steps[last]
        changed = scan, truth, msgspec.structs.replace(belief, **believed)
        answer = drive(stage, [*steps[:last], changed], **answered)
    if state == "past":
        shows(stage, lambda: len(page.history()) == LOCALIZED_AT + 1)
        page.run(f"liveView.travel.goTo({AMBIGUOUS_AT})")
    for window in WINDOWS:
        for scheme in ("light", "dark"):
            with page.on_screen(window, scheme):
                page.run("scrollTo(0, 0); liveView.view.fit()")

                def is_shown() -> bool:
                    if answer is not None:
                        stage.picture.on_pose(answer)  # else it is stale after three seconds
                    seen = page.run(GLANCE)
                    return all(fact in seen.get(name, "") for name, fact in facts.items())

                shows(stage, is_shown)
                assert "link" in page.run(GLANCE), "the dot that shows whether it is alive"
                assert page.run(COLLISIONS) == []
                is_sure = state not in ("searching", "lost", "stale", "dead_reckoning")
                assert int(page.run(WEIGHT)) == (600 if is_sure else 400)
                assert not page.run("return document.documentElement.scrollWidth > innerWidth")
                page.save(pictures / f"ten-{state}-{window}-{scheme}.png")
    driver.get("about:blank")
    assert page.console() == []
