"""Three runs of a simulated robot, each as a page in one file that plays in the browser.

python docs/play_runs.py FOLDER      writes them; the site makes them by itself
"""

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from clustermcl.belief.outcome import Outcome, belief_after
from clustermcl.jobs.in_process import InProcess
from clustermcl.jobs.map_model import sensor_model
from clustermcl.protocol.job_events import JobEvents, NumberedEvent
from clustermcl.protocol.steps import TruePose
from clustermcl.protocol.work import TrackJob
from clustermcl.recordings.maps.map_message import to_message
from clustermcl.runtime.settings import Settings
from clustermcl.simulator.simulation import Simulation, simulated_steps
from clustermcl.simulator.worlds.catalogue import world
from clustermcl.view.picture import Picture
from clustermcl.view.recorded_run import best_pose
from clustermcl.view.saved_page import saved_run

CLOUD_EVERY_STEPS = 10
MOST_CLOUDS = 8
"""With more places, particles would make the file too large."""


@dataclass(frozen=True)
class Story:
    """A run to show."""

    world: str
    title: str
    steps: int
    seed: int = 0
    kidnap_at: int | None = None


STORIES = {
    "story": Story("cross_feature", "four arms that look alike, and one cabinet", 200),
    "office": Story("office", "an office of identical rooms", 100),
    "kidnapping": Story("hall", "a robot that is kidnapped at step 60", 160, kidnap_at=60),
}


def page(story: Story, progress: Callable[[int], None] = lambda _step: None) -> str:
    """Run it, and return its page."""
    place, settings = world(story.world), Settings(seed=story.seed)
    simulation = Simulation(place, story.seed)
    with tempfile.TemporaryDirectory() as cache:
        run = InProcess(sensor_model(place.map, settings.sensor, Path(cache)), settings)
    picture = Picture({"robot": story.title, "router": "", "commands": False, "story": True})
    picture.on_link("running")
    picture.on_map(to_message(place.map, "docs"))
    events = 0
    for scan, truth in simulated_steps(simulation, settings.bridge, steps=story.steps):
        if scan.step == story.kidnap_at:
            simulation.kidnap()
        outcome = run.advance(scan)
        picture.on_scan(scan)
        picture.on_truth(TruePose(sender="docs", step=scan.step, pose=truth))
        picture.on_events(_events(outcome, events, scan.stamp_ns))
        events += len(outcome.events)
        belief = belief_after(scan, outcome, "docs")
        picture.on_belief(belief)
        picture.on_pose(best_pose(belief))
        if scan.step % CLOUD_EVERY_STEPS == 0 and len(belief.hypotheses) <= MOST_CLOUDS:
            for job in (running.handed_on().job for running in run.jobs.values()):
                if isinstance(job, TrackJob) and job.start.step == scan.step:
                    picture.on_particles(job.cluster, job.start)
        progress(scan.step)
    picture.on_link("finished")
    return saved_run(picture)


def _events(outcome: Outcome, first: int, stamp_ns: int) -> JobEvents:
    numbered = (
        NumberedEvent(number=first + index, step=outcome.step, stamp_ns=stamp_ns, event=event)
        for index, event in enumerate(outcome.events)
    )
    return JobEvents(sender="docs", events=tuple(numbered))


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    for name, story in STORIES.items():
        (folder / f"{name}.html").write_text(page(story))
