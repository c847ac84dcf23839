"""A finished run on the page: told to it while browsers look, without any system."""

import time
from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

from coordinator.recorder.replay import Believed, CoordinatorActs, Happened, Happening
from live_view.live_loop import answer_browser
from live_view.map_reduction import reduced
from live_view.picture import Picture
from live_view.room import Commanded, FromBrowser, Room
from live_view.serving import PageOptions, opened_page
from live_view.step_archive import StepArchive
from process_runtime.stop import StopFlag
from protocol.answers import Belief, PoseAnswer
from protocol.job_events import JobEvents
from protocol.steps import MapMessage
from zenoh_link.inbox import Inbox

KEPT_STEPS = 100_000
KEPT_BYTES = 200_000_000
_AT_A_TIME_S = 0.05
_POLL_S = 0.1


Telling: TypeAlias = Callable[[Picture], Iterator[None]]
"""Tells a picture what happened, a little each time it is asked for more.

Raises an `InputFileError` where the recording cannot be read.
"""


class RecordedRun:
    """Tells the picture what happened, a little at a time, and answers browsers in between.

    Args:
        telling: what happened: `flight_run`, or `live_view.recorded_bag.bag_run`.
        grid_map: what it happened in; None: not known, so none is drawn.
        about: what pages are told once.
    """

    def __init__(
        self,
        telling: Telling,
        grid_map: MapMessage | None,
        about: dict[str, Any],
    ) -> None:
        self._inbox: Inbox[FromBrowser] = Inbox({})
        self.room = Room("recording", self._inbox.put)
        about = {"router": "", "commands": False, **about, "kept_steps": KEPT_STEPS}
        self.picture = Picture(about, StepArchive(KEPT_STEPS, KEPT_BYTES))
        self.picture.on_link("replaying")
        if grid_map is not None:
            shown = reduced(grid_map)
            self.room.set_map(shown.digest, shown.zlib_cells)
            self.picture.on_map(shown)
        self._telling = telling(self.picture)

    def run(self, stop: StopFlag) -> None:
        """Tell all of it, and show it until told to stop.

        Raises:
            InputFileError: the recording cannot be read.
        """
        while not stop.is_set():
            goes_on = self.replay_for(_AT_A_TIME_S)
            event = self._inbox.get(0.0 if goes_on else _POLL_S)
            while event is not None:
                if not isinstance(event, Commanded):
                    answer_browser(self.room, self.picture, event)
                event = self._inbox.get(0.0)
            if changes := self.picture.changes():
                self.room.publish(changes)

    def replay_for(self, seconds: float) -> bool:
        """Go on for so long; False: that was all."""
        until_s = time.monotonic() + seconds
        for _ in self._telling:
            if time.monotonic() >= until_s:
                return True
        self.picture.on_link("finished")
        return False


def flight_run(happenings: Iterator[tuple[int, Happening]]) -> Telling:
    """What a flight recording tells the page, which is computed again.

    Args:
        happenings: as `coordinator.recorder.replay.replayed` gives them.
    """

    def tell(picture: Picture) -> Iterator[None]:
        acting = 0
        for _, happening in happenings:
            match happening:
                case CoordinatorActs(term=term):
                    acting = term
                case Believed(belief, _):
                    picture.on_belief(belief)
                    picture.on_pose(best_pose(belief))
                case Happened(numbered=numbered) if numbered is not None:
                    events = JobEvents(sender="recording", events=(numbered,), term=acting)
                    picture.on_events(events)
            yield

    return tell


def serve_recording(
    run: RecordedRun, stop: StopFlag, options: PageOptions, say: Callable[[str], None]
) -> None:
    """Serve the page of a finished run until `stop` is set.

    Raises:
        SettingsError: the address or a certificate cannot be used.
        InputFileError: the recording cannot be read.
    """
    with opened_page(options, [run.room], say):
        run.run(stop)


def best_pose(belief: Belief) -> PoseAnswer:
    """The most probable place, as the coordinator said it right after the step."""
    best = belief.hypotheses[0] if belief.hypotheses else None
    return PoseAnswer(
        sender=belief.sender,
        state=belief.state,
        freshness="fresh",
        stamp_ns=belief.stamp_ns,
        age_s=0.0,
        step=belief.step,
        probability=best.probability if best else 0.0,
        map_from_robot=best.mean if best else None,
        covariance=best.covariance if best else None,
        workers=0,
        term=belief.term,
    )
