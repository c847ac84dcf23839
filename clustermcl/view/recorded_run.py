"""Shows a recorded run on the page, which can be used while the recording is still read."""

import logging
import math
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from clustermcl.link.inbox import Inbox
from clustermcl.protocol.answers import Belief, PoseAnswer
from clustermcl.protocol.errors import RecordingError, escaped
from clustermcl.protocol.floors import ONE_MAP, Floors
from clustermcl.protocol.job_events import JobEvents
from clustermcl.protocol.reading_checks import MAX_LASERS
from clustermcl.protocol.steps import KEPT_STEPS as KEPT_SCANS
from clustermcl.protocol.steps import MapMessage, Scan
from clustermcl.recordings import run_log
from clustermcl.recordings.foxglove import LaserFields
from clustermcl.recordings.maps.map_message import to_message
from clustermcl.runtime.compressed import os_problem
from clustermcl.runtime.output_files import check_output_file, write_output_file
from clustermcl.runtime.stop import StopFlag, stop_on_signals
from clustermcl.view.admission import Address
from clustermcl.view.browser import FromBrowser
from clustermcl.view.live_loop import answer_browser
from clustermcl.view.page_server import PageServer
from clustermcl.view.picture import Picture
from clustermcl.view.rerun_log import RerunLog
from clustermcl.view.saved_page import saved_run
from clustermcl.view.step_archive import StepArchive

RERUN = ".rrd"
KEPT_STEPS = 100_000
KEPT_BYTES = 200_000_000
_OF_BELIEF = (
    "sender", "state", "stamp_ns", "step", "probability", "term", "elsewhere_probability",
    "off_map_probability", "floor", "floors",
)  # fmt: skip
_AT_A_TIME_S = 0.05
_POLL_S = 0.1

_log = logging.getLogger(__name__)


def view_recording(recording: Path, address: Address, save_file: Path | None = None) -> None:
    """Serve the page of a recorded run until Ctrl-C, or save it: a page, or ``.rrd`` for Rerun."""
    stop = stop_on_signals()
    if not recording.exists():
        raise RecordingError(recording, os_problem(FileNotFoundError()))
    if not run_log.is_run_log(recording):
        if runs := [each.name for each in sorted(recording.glob("*/")) if run_log.is_run_log(each)]:
            problem = f"it contains recorded runs in folders: name one of {', '.join(runs)}"
            raise RecordingError(recording, problem)
        problem = "is not a recorded run: no flight recorder wrote it"
        remedy = f"to localize with it: clustermcl demo --view --recording {recording}"
        raise RecordingError(recording, f"{problem}; {remedy}")
    if save_file is not None:
        check_output_file(save_file)
        if save_file.suffix == RERUN:
            RecordedRun(recording, RerunLog(save_file)).read_for(math.inf)
        else:
            write_output_file(save_file, RecordedRun(recording).saved())
        return
    RecordedRun(recording).serve(address, stop)


class RecordedRun:
    """The page of a recorded run, a run log or the folder of a flight recorder.

    `into` takes it in place of the page.
    """

    def __init__(self, path: Path, into: RerunLog | None = None) -> None:
        about: dict[str, Any] = {
            "router": "", "commands": False, "robot": escaped(path.resolve().stem),
            "kept_steps": KEPT_STEPS,
        }  # fmt: skip
        self.picture = Picture(about, StepArchive(KEPT_STEPS, KEPT_BYTES))
        self._shown: Picture | RerunLog = into or self.picture
        self._shown.on_link("replaying")
        self._map: MapMessage | None = None
        self._lasers: deque[LaserFields] = deque(maxlen=KEPT_SCANS)
        self._pieces = self._read(run_log.log_files(path))

    def serve(self, address: Address, stop: StopFlag) -> None:
        """Read the recording in small pieces, and answer browsers, until `stop` is set."""
        inbox: Inbox[FromBrowser] = Inbox({})
        with PageServer(address, self.picture, inbox.put) as server:
            while not stop.is_set():
                goes_on = self.read_for(_AT_A_TIME_S)
                event = inbox.get(0.0 if goes_on else _POLL_S)
                while event is not None:
                    answer_browser(server, self.picture, event)  # a recording obeys no command
                    event = inbox.get(0.0)
                if changes := self.picture.changes():
                    server.publish(changes)

    def saved(self) -> str:
        """Read the whole recording, and return an HTML page that plays it."""
        self.read_for(math.inf)
        return saved_run(self.picture)

    def read_for(self, seconds: float) -> bool:
        """Read on for some seconds; return whether there is more to read."""
        until_s = time.monotonic() + seconds
        for _ in self._pieces:
            if time.monotonic() >= until_s:
                return True
        self._shown.on_link("finished")
        return False

    def _read(self, files: list[Path]) -> Iterator[None]:
        for path in files:
            log = run_log.RunLogReader(path)
            for message in log.messages():
                self._on_message(message, path)
                yield
            if log.cut:
                _log.warning("%s is cut off or damaged: %s", path, log.cut)

    def _on_message(self, message: run_log.LogMessage, path: Path) -> None:
        if message.topic == run_log.BELIEF:
            self._on_belief(run_log.decoded(message, Belief, path))
        elif message.topic == run_log.JOB_EVENTS:
            self._shown.on_events(run_log.decoded(message, JobEvents, path))
        elif message.topic.startswith(run_log.SCAN):
            self._lasers.append(run_log.decoded(message, LaserFields, path))
        elif message.topic == run_log.GRID:
            grid_map = run_log.map_in(message, path)
            if self._map is None or grid_map.digest != self._map.digest:
                self._map = to_message(grid_map, "recording")
                self._shown.on_map(self._map)

    def _on_belief(self, belief: Belief) -> None:
        lasers = [laser for laser in self._lasers if laser.step == belief.step][:MAX_LASERS]
        while self._lasers and self._lasers[0].step <= belief.step:
            self._lasers.popleft()
        if lasers:
            floors = self._map.floors if self._map else ONE_MAP
            self._shown.on_scan(_scan(belief, lasers, floors))
        self._shown.on_belief(belief)
        self._shown.on_pose(best_pose(belief))


def _scan(belief: Belief, lasers: list[LaserFields], floors: Floors) -> Scan:
    first, *others = [laser.beams() for laser in lasers]
    return Scan(
        sender=belief.sender,
        step=belief.step,
        stamp_ns=belief.stamp_ns,
        odom_from_robot=belief.odom_from_robot,
        **msgspec.structs.asdict(first),
        map_digest=lasers[0].map_digest,
        others=tuple(others),
        floors=floors,
    )


def best_pose(belief: Belief) -> PoseAnswer:
    """Return the most probable place in the form of the coordinator's answer."""
    best = belief.best
    return PoseAnswer(
        freshness="fresh",
        age_s=0.0,
        pose=best.pose if best else None,
        covariance=best.covariance if best else None,
        workers=0,
        **{name: getattr(belief, name) for name in _OF_BELIEF},
    )
