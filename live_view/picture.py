"""What the page shows, kept up to date from the messages of one robot's system."""

from collections import deque
from typing import Any

from live_view.colour_slots import ColourSlots
from live_view.frames import (
    Frame,
    events_frame,
    history_row,
    map_frame,
    pose_frame,
    status_frame,
    step_frame,
)
from protocol.answers import Belief, PoseAnswer, Status
from protocol.job_events import JobEvents, NumberedEvent
from protocol.message import PoseTuple
from protocol.steps import MapMessage, Scan, TruePose

MAX_HISTORY_STEPS = 1000
MAX_EVENTS = 100
_KEPT_STEPS = 64
"""Scans and true poses that wait for the belief of their step."""


class Picture:
    """Told of messages; gives the frames that have changed, or all, by topic.

    Topics are states, so whoever gets the newest frame of each has everything: ``system``, ``map``,
    ``step``, ``pose``, ``status``, ``events``. Only ``history``, the steps so far, is given once,
    and anew when it begins anew; the page adds each step to it itself.

    Args:
        system: what does not change: the robot's name, the router, whether commands are allowed.
    """

    def __init__(self, system: Frame) -> None:
        self._frames: dict[str, Any] = {"system": {**system, "link": "no router"}}
        self._changed = {"system"}
        self._history: deque[list[Any]] = deque(maxlen=MAX_HISTORY_STEPS)
        self._slots = ColourSlots()
        self._scans: dict[int, Scan] = {}
        self._truths: dict[int, PoseTuple] = {}
        self._events: dict[int, NumberedEvent] = {}
        self._events_term = self._term = 0
        self._last_step = -1
        self.wanted_map = ""
        """Digest of the map that the system localizes in; empty: not known, any will do."""

    @property
    def has_wanted_map(self) -> bool:
        """False: the map should be asked for."""
        shown = self._frames.get("map")
        return shown is not None and self.wanted_map in ("", shown["digest"])

    @property
    def link(self) -> str:
        """``no router``, ``no system`` behind the router, or ``running``."""
        link: str = self._frames["system"]["link"]
        return link

    def changes(self) -> dict[str, Any]:
        """The frames that have changed since this was called last."""
        changed = {topic: self._frame(topic) for topic in sorted(self._changed)}
        self._changed.clear()
        return changed

    def everything(self) -> dict[str, Any]:
        """All frames, for a page that has just been opened."""
        return {topic: self._frame(topic) for topic in ("history", *self._frames)}

    def on_link(self, link: str) -> None:
        """The router or the system behind it came or went."""
        if link != self.link:
            self._set("system", {**self._frames["system"], "link": link})
            if link != "running":
                self._term = self._events_term = 0  # whoever comes next may count from 0

    def on_map(self, message: MapMessage) -> None:
        """The map has come."""
        self._set("map", map_frame(message))

    def on_scan(self, scan: Scan) -> None:
        """A scan, whose belief follows."""
        self.wanted_map = scan.map_digest
        _keep(self._scans, scan.step, scan)

    def on_truth(self, truth: TruePose) -> None:
        """Where a simulated robot really is at a step."""
        _keep(self._truths, truth.step, truth.map_from_robot)
        shown = self._frames.get("step")
        if shown is not None and shown["step"] == truth.step:
            self._set("step", {**shown, "truth": truth.map_from_robot})
            self._history[-1][2] = truth.map_from_robot

    def on_belief(self, belief: Belief) -> None:
        """A step was applied, or a command changed what is believed after it."""
        if belief.term < self._term:
            return
        if belief.step < self._last_step:
            self._forget()
        self._term, self._last_step = belief.term, belief.step
        slots = self._slots.assign(place.cluster for place in belief.hypotheses)
        scan, truth = self._scans.get(belief.step), self._truths.get(belief.step)
        frame = step_frame(belief, slots, scan, truth)
        if self._history and self._history[-1][0] == belief.step:
            self._history.pop()
        self._history.append(history_row(frame))
        self._set("step", frame)

    def on_pose(self, answer: PoseAnswer) -> None:
        """Where the robot is now."""
        if answer.term >= self._term:
            self._set("pose", pose_frame(answer))

    def on_status(self, status: Status) -> None:
        """The system has answered how it is, so it is there."""
        self.on_link("running")
        self.wanted_map = status.map_digest or self.wanted_map
        self._set("status", status_frame(status))

    def on_events(self, heard: JobEvents) -> bool:
        """What has begun and ended; False: some are missing, ask for all of them."""
        if heard.term < self._events_term:
            return True
        if heard.term > self._events_term:
            self._events_term = heard.term
            self._events.clear()
        expected = max(self._events, default=-1) + 1
        new = {event.number: event for event in heard.events if event.number not in self._events}
        if new:
            numbers = sorted(self._events | new)[-MAX_EVENTS:]
            self._events = {number: (self._events | new)[number] for number in numbers}
            self._set("events", events_frame(self._events.values()))
        return min(new, default=expected) <= expected

    def _forget(self) -> None:
        """The steps begin anew: what is drawn of the old ones would only mislead."""
        self._history.clear()
        self._events.clear()
        self._slots = ColourSlots()
        self._set("events", [])
        self._changed.add("history")

    def _frame(self, topic: str) -> Any:
        return list(self._history) if topic == "history" else self._frames[topic]

    def _set(self, topic: str, frame: Any) -> None:
        self._frames[topic] = frame
        self._changed.add(topic)


def _keep(of_step: dict[int, Any], step: int, value: Any) -> None:
    """Keep the newest by step; a count that begins anew makes the older ones go all the same."""
    of_step.pop(step, None)
    of_step[step] = value
    while len(of_step) > _KEPT_STEPS:
        del of_step[next(iter(of_step))]
