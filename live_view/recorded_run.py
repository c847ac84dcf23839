"""A flight recording on the page: computed again while browsers look, without any system."""

import time
from collections.abc import Callable, Iterator
from typing import Any

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


class RecordedRun:
    """Tells the picture what happened, a little at a time, and answers browsers in between.

    Args:
        happenings: as `coordinator.recorder.replay.replayed` gives them.
        grid_map: what it happened in; None: not known, so none is drawn.
        about: what pages are told once.
    """

    def __init__(
        self,
        happenings: Iterator[tuple[int, Happening]],
        grid_map: MapMessage | None,
        about: dict[str, Any],
    ) -> None:
        self._happenings, self._term = happenings, 0
        self._inbox: Inbox[FromBrowser] = Inbox({})
        self.room = Room("recording", self._inbox.put)
        about = {"router": "", "commands": False, **about, "kept_steps": KEPT_STEPS}
        self.picture = Picture(about, StepArchive(KEPT_STEPS, KEPT_BYTES))
        self.picture.on_link("replaying")
        if grid_map is not None:
            shown = reduced(grid_map)
            self.room.set_map(shown.digest, shown.zlib_cells)
            self.picture.on_map(shown)

    def run(self, stop: StopFlag) -> None:
        """Replay to the end, and show it until told to stop.

        Raises:
            FlightRecordingError: the recording cannot be read.
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
        """Compute for so long; False: that was all."""
        until_s = time.monotonic() + seconds
        for _, happening in self._happenings:
            self._on_happening(happening)
            if time.monotonic() >= until_s:
                return True
        self.picture.on_link("finished")
        return False

    def _on_happening(self, happening: Happening) -> None:
        match happening:
            case CoordinatorActs(term=term):
                self._term = term
            case Believed(belief, _):
                self.picture.on_belief(belief)
                self.picture.on_pose(_best(belief))
            case Happened(numbered=numbered) if numbered is not None:
                events = JobEvents(sender="recording", events=(numbered,), term=self._term)
                self.picture.on_events(events)


def serve_recording(
    run: RecordedRun, stop: StopFlag, options: PageOptions, say: Callable[[str], None]
) -> None:
    """Serve the page of a finished run until `stop` is set.

    Raises:
        SettingsError: the address or a certificate cannot be used.
        FlightRecordingError: the recording cannot be read.
    """
    with opened_page(options, [run.room], say):
        run.run(stop)


def _best(belief: Belief) -> PoseAnswer:
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
