"""The frames that the page of one robot shows."""

import math
from collections import deque
from collections.abc import Container, Mapping, Sequence
from typing import Any

import msgspec
from msgspec.structs import replace

from clustermcl.protocol.answers import Belief, PoseAnswer, Status
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.floors import ONE_MAP
from clustermcl.protocol.job_events import JobEvents, NumberedEvent
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import MapMessage, Scan, TruePose
from clustermcl.protocol.work import Particles
from clustermcl.view import frames
from clustermcl.view.step_archive import StepArchive

NEWEST_ROWS = 1000
"""Limit for the rows in one answer; the page requests older rows when they are needed."""
MAX_EVENTS = 1000
SHOWN_EVENTS = 100
_KEPT_STEPS = 64
"""Limit for the scans, and for the true poses, that are kept until their belief arrives."""
SLOTS = 8
"""Number of colours; higher slots have the same colours with dashed outlines."""


class Picture:
    """The newest frame of each topic, made from messages, and an archive of earlier frames.

    The topics are ``system``, ``map``, ``step``, ``events``, ``pose`` and ``status``, which are the
    system's own answers, and ``cloud N``: the particles of cluster N, or None once the cluster has
    ended. The topic ``history`` has the newest rows and the number of the oldest kept step. It is
    sent when a page is opened and when the steps restart; in between, the page itself adds each
    new step. ``system`` has constants: the robot's name, the router, whether commands are allowed.
    """

    def __init__(self, system: frames.Frame, archive: StepArchive | None = None) -> None:
        self._frames: dict[str, Any] = {"system": {**system, "link": "no router"}}
        self._changed = {"system"}
        self.archive = archive or StepArchive()
        self._rows: deque[tuple[int, msgspec.Raw]] = deque(maxlen=self.archive.max_steps)
        self._slots: dict[int, int] = {}
        self._scans: dict[int, Scan] = {}
        self._truths: dict[int, PoseTuple] = {}
        self._events: dict[int, NumberedEvent] = {}
        self._events_term = self._term = 0
        self._last_step = -1
        self.map: MapMessage | None = None
        """The drawn map, reduced."""
        self._floors = ONE_MAP
        """All that is drawn is in their atlas."""
        self.wanted_map = ""
        """Digest of the map that the system uses; empty: unknown, so that any map is shown."""

    @property
    def has_wanted_map(self) -> bool:
        shown = self._frames.get("map")
        return shown is not None and self.wanted_map in ("", shown["digest"])

    @property
    def link(self) -> str:
        """State of the connection, such as ``no router``, ``no system`` or ``running``."""
        link: str = self._frames["system"]["link"]
        return link

    def changes(self) -> dict[str, Any]:
        """Return the frames that have changed since the last call, by topic."""
        changed = {topic: self._frame(topic) for topic in sorted(self._changed)}
        self._changed.clear()
        return changed

    def past(self, step: int) -> dict[str, Any]:
        """Return the frames of a past step by topic, as far as they are archived."""
        return {**self.archive.at(step), "events": self.events_until(step)}

    def events_until(self, step: float = math.inf, most: int = SHOWN_EVENTS) -> list[frames.Frame]:
        events = [event for event in self._events.values() if event.step <= step]
        return frames.events_frame(events[-most:])

    def rows_before(self, step: int) -> list[msgspec.Raw]:
        """Return at most `NEWEST_ROWS` rows before a step, for trails and plot."""
        return [row for known, row in self._rows if known < step][-NEWEST_ROWS:]

    def everything(self) -> dict[str, Any]:
        """Return the frames of all topics, for a page that was just opened."""
        return {topic: self._frame(topic) for topic in ("history", *self._frames)}

    def on_link(self, link: str) -> None:
        if link != self.link:
            self._set("system", {**self._frames["system"], "link": link})
            if link != "running":
                self._term = self._events_term = 0  # the next coordinator may count from 0

    def on_map(self, message: MapMessage) -> None:
        """Draw a map; if it is damaged, this raises a MalformedMessageError."""
        self.map, self._floors = frames.reduced(message), message.floors
        self._set("map", frames.map_frame(self.map))

    def on_scan(self, scan: Scan) -> None:
        """Store a scan for its belief, or show it if its belief arrived first."""
        self.wanted_map, self._floors = scan.map_digest, scan.floors
        _keep(self._scans, scan.step, scan)
        if shown := self._shown_at(scan.step):
            self._set_step({**shown, **frames.scan_frame(scan)})

    def on_truth(self, truth: TruePose) -> None:
        """Store the true pose at a step for its belief, or show it if its belief arrived first."""
        pose = self._floors.drawn_pose(truth.floor, truth.pose)
        _keep(self._truths, truth.step, pose)
        if shown := self._shown_at(truth.step):
            self._set_step({**shown, "truth": pose})

    def on_particles(self, cluster: int, particles: Particles) -> None:
        self._show(f"cloud {cluster}", frames.cloud_frame(cluster, particles))

    def on_belief(self, belief: Belief) -> None:
        """Show a belief; ignore one of an earlier coordinator.

        Drop all past steps if the count of steps has restarted.
        """
        if belief.term < self._term:
            return
        if belief.step < self._last_step:
            self._forget()
        self._term, self._last_step = belief.term, belief.step
        self._slots = colour_slots(self._slots, [each.cluster for each in belief.hypotheses])
        scan, truth = self._scans.get(belief.step), self._truths.get(belief.step)
        self._drop_clouds_but(self._slots)
        self._set_step(frames.step_frame(self._floors.drawn(belief), self._slots, scan, truth))

    def on_pose(self, answer: PoseAnswer) -> None:
        """Show the robot's present pose; ignore an answer of an earlier coordinator."""
        if answer.term < self._term:
            return
        if answer.pose is not None:
            answer = replace(answer, pose=self._floors.drawn_pose(answer.floor, answer.pose))
        self._show("pose", answer)

    def on_status(self, status: Status) -> None:
        self.on_link("running")
        self.wanted_map = status.map_digest or self.wanted_map
        self._show("status", status)

    def on_changes(self, changes: Changes) -> None:
        self._show("changes", frames.changes_frame(changes))

    def on_events(self, published: JobEvents) -> bool:
        """Add events; return False if earlier events are missing and have to be queried."""
        if published.term < self._events_term:
            return True
        new = {event.number: event for event in published.events}
        if published.term > self._events_term:  # it has those before from its predecessor
            self._events_term, first = published.term, min(new, default=0)
            self._events = {n: event for n, event in self._events.items() if n < first}
        expected = max(self._events, default=-1) + 1
        if new.keys() - self._events.keys():
            self._events = dict(sorted((self._events | new).items())[-MAX_EVENTS:])
            self._set("events", self.events_until())
        return min(new, default=expected) <= expected

    def _forget(self) -> None:
        self._rows.clear()
        self.archive.clear()
        self._events.clear()
        self._drop_clouds_but(())
        self._set("events", [])
        self._changed.add("history")

    def _shown_at(self, step: int) -> frames.Frame | None:
        """Return the frame of the shown step if it has this number, else None."""
        shown: frames.Frame | None = self._frames.get("step")
        return shown if shown is not None and shown["step"] == step else None

    def _set_step(self, frame: frames.Frame) -> None:
        """Show a step, in place of its earlier frame if it has one."""
        step = frame["step"]
        if self._rows and self._rows[-1][0] == step:
            self._rows.pop()
        self._rows.append((step, msgspec.Raw(msgspec.json.encode(frames.history_row(frame)))))
        self._show("step", frame)

    def _drop_clouds_but(self, clusters: Container[int]) -> None:
        clouds = [topic for topic in self._frames if topic.startswith("cloud ")]
        for topic in clouds:
            if self._frames[topic]["cluster"] not in clusters:
                del self._frames[topic]
                self._changed.add(topic)

    def _frame(self, topic: str) -> Any:
        if topic == "history":
            oldest = self._rows[0][0] if self._rows else 0
            return {"oldest": oldest, "rows": self.rows_before(self._last_step + 1)}
        return self._frames.get(topic)

    def _show(self, topic: str, frame: Any) -> None:
        """Show a frame, and archive it for its step."""
        self._set(topic, frame)
        self.archive.add(self._last_step, topic, frame)

    def _set(self, topic: str, frame: Any) -> None:
        self._frames[topic] = frame
        self._changed.add(topic)


def _keep(of_step: dict[int, Any], step: int, value: Any) -> None:
    """Store a value; drop those stored first, because the count of steps may restart."""
    of_step.pop(step, None)
    of_step[step] = value
    while len(of_step) > _KEPT_STEPS:
        del of_step[next(iter(of_step))]


def colour_slots(before: Mapping[int, int], clusters: Sequence[int]) -> dict[int, int]:
    """Return the colour slot of each cluster: that of before, or a free one.

    A new cluster gets the colour that it has in the plots if that is free, else the lowest slot.
    """
    slots = {cluster: before[cluster] for cluster in clusters if cluster in before}
    for cluster in clusters:
        if cluster not in slots:
            wanted, taken = (cluster % SLOTS, *range(len(clusters))), set(slots.values())
            slots[cluster] = next(slot for slot in wanted if slot not in taken)
    return slots
