"""The process that localizes a demo's robot by AMCL's filter too, for comparison on the page.

It receives the robot's scans, and publishes scans, ground truth and its own belief under the name
of a second robot, which the page draws in a second map.
"""

import time
from collections import deque
from collections.abc import Iterator
from importlib.metadata import version

import msgspec

from coordinator.belief.outcome import Outcome, belief_after
from evaluation.run import ALGORITHMS
from grid_maps.map_message import from_message
from particle_filter.sensor_model import SensorModel
from process_runtime.main import Invocation, process_main
from process_runtime.settings import Settings
from protocol import keys
from protocol.answers import Status
from protocol.job_events import Began, Ended, JobEvents
from protocol.names import LONGEST_NAME
from protocol.steps import MapMessage, Scan, TruePose
from worker.map_model import default_cache_folder, sensor_model
from zenoh_link.node import Node
from zenoh_link.wire import Asked

_SUFFIX = "-amcl"
_POLL_S = 0.05
_MAP_TIMEOUT_S = 30.0
_MAP_WITHIN_S = 120.0
_KEPT = 1024


def amcl_name(robot: str) -> str:
    """Return the name of the second robot, as which AMCL's belief is published."""
    return robot[: LONGEST_NAME - len(_SUFFIX)].rstrip("-") + _SUFFIX


def main() -> None:
    process_main(
        "amcl",
        run_amcl,
        describe="Localizes a robot by augmented MCL, as AMCL does, for the page of a demo.",
    )


def run_amcl(invocation: Invocation) -> None:
    settings, stop, name = invocation.settings, invocation.stop, invocation.process
    own_robot = msgspec.structs.replace(settings.robot, name=amcl_name(settings.robot.name))
    own_settings = msgspec.structs.replace(settings, robot=own_robot)
    robot, own = (
        Node(name, "baseline", each, stop, peers=None) for each in (settings, own_settings)
    )
    follower = Follower(settings)
    belief, scans, truths = map(own.publisher, (keys.BELIEF, keys.SCAN, keys.TRUTH))

    def on_map(message: MapMessage) -> None:
        own.serve(keys.MAP, lambda asked: asked.answer(message))
        grid_map = from_message(message)
        follower.use(sensor_model(grid_map, settings.sensor, default_cache_folder()), message)

    def on_status_asked(asked: Asked) -> None:
        asked.answer(follower.status(name))

    robot.subscribe(
        keys.SCAN, Scan, lambda scan, _: follower.on_scan(scan), kind="scan", kept=_KEPT
    )
    robot.subscribe(
        keys.EVENTS, JobEvents, lambda events, _: follower.on_events(events), kind="events", kept=64
    )
    robot.subscribe(keys.TRUTH, TruePose, lambda truth, _: truths.put(truth), kind="truth", kept=64)
    own.serve(keys.STATUS, on_status_asked)
    try:
        robot.open()
        own.open()
        robot.ask(
            keys.MAP, MapMessage, on_map, timeout_s=_MAP_TIMEOUT_S, repeat_for_s=_MAP_WITHIN_S
        )
        while not stop.is_set():
            robot.turn(_POLL_S)
            own.turn(0.0)
            for scan, outcome in follower.advance():
                scans.put(scan)
                belief.put(belief_after(scan, outcome, name))
    finally:
        robot.close()
        own.close()


class Follower:
    """AMCL's filter, applied to the robot's scans; it restarts when the robot is relocalized."""

    def __init__(self, settings: Settings) -> None:
        self._settings, self._began_s = settings, time.monotonic()
        self._model: SensorModel | None = None
        self._digest = ""
        self._waiting: deque[Scan] = deque()
        self._outcomes: Iterator[tuple[Scan, Outcome]] | None = None
        self._last: Outcome | None = None

    def use(self, model: SensorModel, message: MapMessage) -> None:
        self._model, self._digest = model, message.digest

    def on_scan(self, scan: Scan) -> None:
        if self._last is not None and scan.step <= self._last.step:
            self._outcomes = None
        self._waiting.append(scan)

    def on_events(self, published: JobEvents) -> None:
        """Restart after the command `relocalize`, but not after a pose given by a user."""
        events = [numbered.event for numbered in published.events]
        is_given = any(isinstance(event, Began) and event.cause == "given" for event in events)
        if not is_given and any(
            isinstance(event, Ended) and event.cause == "forgotten" for event in events
        ):
            self._outcomes = None

    def advance(self) -> Iterator[tuple[Scan, Outcome]]:
        while self._waiting and self._model is not None:
            if self._outcomes is None:
                follow = ALGORITHMS["amcl"]
                waiting = iter(self._waiting.popleft, None)
                self._outcomes = follow(waiting, self._model, self._settings)
            scan, self._last = next(self._outcomes)
            yield scan, self._last

    def status(self, sender: str) -> Status:
        last = self._last
        step = -1 if last is None else last.step
        return Status(
            sender=sender,
            version=version("clustermcl"),
            state="searching" if last is None else last.state,
            freshness="none" if last is None else "fresh",
            age_s=0.0,
            step=step,
            steps_applied=step + 1,
            steps_lost=0,
            reports_missing=0,
            map_digest=self._digest,
            clusters=0 if last is None else len(last.hypotheses),
            searching=False,
            workers={},
            counters={},
            uptime_s=time.monotonic() - self._began_s,
        )


if __name__ == "__main__":
    main()
