"""What the page shows, kept up to date from the messages of one robot's system."""

from collections import deque
from collections.abc import Container
from typing import Any

import msgspec

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
from live_view.particle_clouds import cloud_frame, cluster_of
from live_view.step_archive import ArchiveEntry, StepArchive
from protocol.answers import Belief, PoseAnswer, Status
from protocol.job_events import JobEvents, NumberedEvent
from protocol.message import PoseTuple
from protocol.steps import MapMessage, Scan, TruePose
from protocol.work import Particles, TrackReport

NEWEST_ROWS = 1000
"""Of the steps so far, what a page is given at once; older ones it asks for."""
MAX_EVENTS = 1000
SHOWN_EVENTS = 100
_KEPT_STEPS = 64
"""Scans and true poses that wait for the belief of their step."""


class Picture:
    """Told of messages; gives the frames that have changed, or all, by topic.

    Topics are states, so whoever gets the newest frame of each has everything: ``system``, ``map``,
    ``step``, ``pose``, ``status``, ``events``, and ``cloud N``, the particles of cluster N, which
    is None once the cluster is gone. Only ``history``, the newest steps and which is the oldest
    that is kept, is given once, and again when the steps restart; the page adds each step itself.

    Args:
        system: what does not change: the robot's name, the router, whether commands are allowed.
        archive: for the steps that can be looked back at; None: of the usual size.
    """

    def __init__(self, system: Frame, archive: StepArchive | None = None) -> None:
        self._frames: dict[str, Any] = {"system": {**system, "link": "no router"}}
        self._changed = {"system"}
        self._archive = archive or StepArchive()
        self._rows: deque[tuple[int, msgspec.Raw]] = deque(maxlen=self._archive.max_steps)
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

    def past(self, step: int) -> dict[str, Any]:
        """The frames as they were after a step; without those that are not known any more."""
        events = [event for event in self._events.values() if event.step <= step]
        return {**self._archive.at(step), "events": events_frame(events[-SHOWN_EVENTS:])}

    @property
    def archived(self) -> list[ArchiveEntry]:
        """Step, topic and frame of all steps that are kept, in their order."""
        return self._archive.everything()

    def rows_before(self, step: int) -> list[msgspec.Raw]:
        """What the way and the plot need of the steps before one, the last of them."""
        rows = [row for known, row in self._rows if known < step]
        return rows[-NEWEST_ROWS:]

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
            self._set_step({**shown, "truth": truth.map_from_robot})

    def on_report(self, report: TrackReport) -> None:
        """What a worker made of a scan: now and then with the particles of its cluster."""
        cluster = cluster_of(report)
        if report.snapshot is not None and cluster is not None:
            self.on_particles(cluster, report.snapshot)

    def on_particles(self, cluster: int, particles: Particles) -> None:
        """The particles of a cluster."""
        frame = cloud_frame(cluster, particles)
        self._set(f"cloud {cluster}", frame)
        self._archive.add(self._last_step, f"cloud {cluster}", frame)

    def on_belief(self, belief: Belief) -> None:
        """A step was applied, or a command changed what is believed after it."""
        if belief.term < self._term:
            return
        if belief.step < self._last_step:
            self._forget()
        self._term, self._last_step = belief.term, belief.step
        slots = self._slots.assign(place.cluster for place in belief.hypotheses)
        scan, truth = self._scans.get(belief.step), self._truths.get(belief.step)
        self._drop_clouds_but(slots)
        self._set_step(step_frame(belief, slots, scan, truth))

    def on_pose(self, answer: PoseAnswer) -> None:
        """Where the robot is now."""
        if answer.term >= self._term:
            frame = pose_frame(answer)
            self._set("pose", frame)
            self._archive.add(self._last_step, "pose", frame)

    def on_status(self, status: Status, latency: Frame | None = None) -> None:
        """The system has answered how it is, so it is there.

        Args:
            status: its answer.
            latency: of the last steps; None: it is not known.
        """
        self.on_link("running")
        self.wanted_map = status.map_digest or self.wanted_map
        frame = {**status_frame(status), "latency": latency}
        self._set("status", frame)
        self._archive.add(self._last_step, "status", frame)

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
            self._set("events", events_frame(list(self._events.values())[-SHOWN_EVENTS:]))
        return min(new, default=expected) <= expected

    def _forget(self) -> None:
        """The steps begin anew: what is drawn of the old ones would only mislead."""
        self._rows.clear()
        self._archive.clear()
        self._events.clear()
        self._drop_clouds_but(())
        self._slots = ColourSlots()
        self._set("events", [])
        self._changed.add("history")

    def _set_step(self, frame: Frame) -> None:
        """Show a step; the same step again replaces it."""
        step = frame["step"]
        if self._rows and self._rows[-1][0] == step:
            self._rows.pop()
        self._rows.append((step, msgspec.Raw(msgspec.json.encode(history_row(frame)))))
        self._archive.add(step, "step", frame)
        self._set("step", frame)

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

    def _set(self, topic: str, frame: Any) -> None:
        self._frames[topic] = frame
        self._changed.add(topic)


def _keep(of_step: dict[int, Any], step: int, value: Any) -> None:
    """Keep the newest by step; a count that begins anew makes the older ones go all the same."""
    of_step.pop(step, None)
    of_step[step] = value
    while len(of_step) > _KEPT_STEPS:
        del of_step[next(iter(of_step))]
