"""Ten states of the page in four windows, light and dark, recognisable at a glance.

The pictures go to BROWSER_PICTURES, for a person to look at.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from coordinator.belief.outcome import belief_after
from evaluation.in_process import outcomes
from grid_maps.map_message import to_message
from particle_filter.settings import FilterSettings
from process_runtime.settings import BridgeSettings
from protocol.answers import Belief, PoseAnswer
from protocol.steps import Scan, TruePose
from robot_simulator.simulation import Simulation
from robot_simulator.source import SimulatedSource, simulated_steps
from robot_simulator.worlds.catalogue import world
from tests.integration.live_view.page import Page
from tests.integration.live_view.stage import Stage
from tests.integration.live_view.test_drawn import many_places, shows
from tests.unit.live_view.messages import events, pose, simulator, status
from worker.map_model import sensor_model

pytestmark = pytest.mark.browser

CROSS = world("cross_feature")
AMBIGUOUS_AT, LOCALIZED_AT = 100, 170
WINDOWS = ("320x700", "768x1024", "1280x800", "2560x1440")

Step = tuple[Scan, TruePose, Belief]


@pytest.fixture(scope="module")
def steps() -> list[Step]:
    """The demo's run: four arms look alike until the robot sees the cabinet."""
    settings = FilterSettings()
    source = SimulatedSource(Simulation(CROSS, settings.seed), steps=LOCALIZED_AT + 2)
    made = list(simulated_steps(source, BridgeSettings(), CROSS.map.digest))[:-1]
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
    """Publish everything up to a step; return its pose, with changes."""
    for scan, truth, belief in steps:
        stage.picture.on_truth(truth)
        stage.picture.on_scan(scan)
        stage.picture.on_belief(belief)
        stage.picture.on_pose(answer_of(belief))
    stage.picture.on_events(events(1, 2, 40))
    digest = CROSS.map.digest
    stage.picture.on_status(status(digest=digest, processes=(simulator(),)))
    return answer_of(steps[-1][2], **changed)


def answer_of(belief: Belief, **changed: Any) -> PoseAnswer:
    best = belief.hypotheses[0] if belief.hypotheses else None
    usual = {
        "state": belief.state,
        "probability": best.probability if best else 0.0,
        "pose": best.pose if best else None,
        "covariance": best.covariance if best else None,
        "elsewhere_probability": belief.elsewhere_probability,
        "off_map_probability": belief.off_map_probability,
    }
    return pose(belief.step, **{**usual, **changed})


def waiting(stage: Stage, _steps: list[Step]) -> None:
    stage.picture.on_link("no system")


def searching(stage: Stage, steps: list[Step]) -> PoseAnswer:
    scan, truth, belief = steps[0]
    none = msgspec.structs.replace(
        belief, state="searching", hypotheses=(), searching=True, search_progress=0.4
    )
    return drive(stage, [(scan, truth, none)])


def ambiguous(stage: Stage, steps: list[Step]) -> PoseAnswer:
    return drive(stage, steps[: AMBIGUOUS_AT + 1])


def many(stage: Stage, steps: list[Step]) -> PoseAnswer:
    scan, truth, _ = steps[0]
    return drive(stage, [(scan, truth, many_places(0))])


def localized(stage: Stage, steps: list[Step]) -> PoseAnswer:
    return drive(stage, steps)


def lost(stage: Stage, steps: list[Step]) -> PoseAnswer:
    scan, truth, belief = steps[-1]
    nowhere = msgspec.structs.replace(
        belief,
        state="lost",
        searching=True,
        search_progress=0.2,
        elsewhere_probability=0.93,
        off_map_probability=0.6,
        hypotheses=tuple(
            msgspec.structs.replace(place, probability=0.07 * place.probability)
            for place in belief.hypotheses
        ),
    )
    return drive(stage, [*steps[:-1], (scan, truth, nowhere)])


def stale(stage: Stage, steps: list[Step]) -> PoseAnswer:
    return drive(stage, steps, freshness="stale", age_s=42.0)


def dead_reckoning(stage: Stage, steps: list[Step]) -> PoseAnswer:
    answer = drive(stage, steps, freshness="dead_reckoning", workers=0)
    stage.picture.on_status(status(digest=CROSS.map.digest, workers={}))
    return answer


def past(stage: Stage, steps: list[Step]) -> PoseAnswer:
    return drive(stage, steps)


def ended(stage: Stage, steps: list[Step]) -> PoseAnswer:
    scan, truth, belief = steps[-1]
    return drive(stage, [*steps[:-1], (scan, truth, msgspec.structs.replace(belief, last=True))])


GLANCE = """
const seen = ["state", "of", "freshness", "probability", "banner", "map", "link"].filter((id) => {
  const one = document.getElementById(id), {left, right, top, bottom} = one.getBoundingClientRect();
  return one.checkVisibility() && one.scrollWidth <= one.clientWidth + 1
    && left >= 0 && right <= innerWidth && top >= 0 && bottom <= innerHeight;
});
return Object.fromEntries(seen.map((id) => [id, document.getElementById(id).innerText]));
"""


@pytest.mark.parametrize(
    ("show", "facts"),
    [
        (waiting, {"banner": "no coordinator localizes"}),
        (searching, {"state": "searching", "probability": "–", "freshness": "0."}),
        (ambiguous, {"state": "ambiguous, 4 places", "probability": "2", "freshness": "0."}),
        (many, {"state": "ambiguous, 64 places", "probability": "9.0 %", "freshness": "0."}),
        (localized, {"state": "localized", "probability": "100 %", "freshness": "0."}),
        (lost, {"state": "lost", "of": "probably not on this map", "freshness": "0."}),
        (stale, {"state": "localized", "freshness": "stale, 4"}),
        (
            dead_reckoning,
            {"state": "localized", "freshness": "dead reckoning", "banner": "No worker is alive"},
        ),
        (past, {"state": "ambiguous, 4 places", "freshness": "before now"}),
        (ended, {"state": "localized", "freshness": "the run has ended"}),
    ],
)
def test_state_places_probability_and_freshness_are_visible_without_scrolling(
    stage: Stage, steps: list[Step], driver: Any, pictures: Path, show: Any, facts: dict[str, str]
) -> None:
    page = Page(driver, stage.server.link)
    shows(stage, lambda: page.run("return liveView.view.map !== null"))
    answer = show(stage, steps)
    if show is past:
        shows(stage, lambda: len(page.history()) == len(steps))
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
                assert not page.run("return document.documentElement.scrollWidth > innerWidth")
                page.save(pictures / f"ten-{show.__name__}-{window}-{scheme}.png")
    driver.get("about:blank")
    assert page.console() == []
