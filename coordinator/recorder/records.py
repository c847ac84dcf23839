"""What a flight recording is made of, and what is left out of it.

No belief is computed from particles or beams in the coordinator: it passes particles on to workers
and leaves beams alone. Both are left out, which makes a step a hundred times smaller.
"""

from typing import TypeAlias

import msgspec
import numpy as np
from msgspec.structs import replace

from coordinator.checkpoint import from_bytes, to_bytes
from coordinator.coordinator import Coordinator
from coordinator.events import (
    CheckpointHeard,
    Event,
    HistoryArrived,
    ReportArrived,
    ScanArrived,
    WorkerToldState,
)
from coordinator.failover.state_recovery import Told
from coordinator.membership.jobs import JobState
from coordinator.pose.last_pose import LastPose
from particle_filter.settings import FilterSettings
from process_runtime.settings import BridgeSettings, CoordinatorSettings
from protocol.answers import Belief
from protocol.arrays import ArrayBlob
from protocol.found_places import FoundPlaces
from protocol.steps import Scan
from protocol.work import (
    Assignment,
    Checkpoint,
    ElsewhereReport,
    Particles,
    Place,
    Report,
    SearchReport,
    TrackJob,
)

NO_BEAMS = ArrayBlob(dtype="float32", shape=(0,), data=b"")
NO_POSES = ArrayBlob(dtype="float64", shape=(0, 3), data=b"")
NO_WEIGHTS = ArrayBlob(dtype="float64", shape=(0,), data=b"")
NO_PARTICLES = ArrayBlob(dtype="float32", shape=(0, 3), data=b"")


class Started(msgspec.Struct, frozen=True, kw_only=True):
    """All that a coordinator was made with."""

    sender: str
    filter_settings: FilterSettings
    settings: CoordinatorSettings
    version: str
    now_ns: int
    term: int
    known: Checkpoint | None
    usual_delay_ns: int | None = None
    last_poses: dict[str, LastPose]
    bridge: BridgeSettings = BridgeSettings()

    def coordinator(self) -> Coordinator:
        """The coordinator, as it was in its first moment."""
        return Coordinator(**{name: getattr(self, name) for name in self.__struct_fields__})


class Head(msgspec.Struct, frozen=True, kw_only=True, tag_field="record", tag="head"):
    """The first record of each file: from here a coordinator can be made that carries on."""

    version: str
    """Of the software; only the same one is sure to decide the same."""
    made_with: str
    """Python, numpy and processor."""
    now_ns: int
    """By the clock of all events."""
    wall_ns: int
    """At the same moment by the wall clock."""
    first_event: int
    """So many events this coordinator was told before, recorded or not."""
    started: Started
    snapshot: bytes
    """What the coordinator knew after them, see `snapshot`; empty before the first event."""


class EventTold(msgspec.Struct, frozen=True, tag_field="record", tag="told", array_like=True):
    """What the coordinator was told; written down before it has taken it in."""

    now_ns: int
    event: Event


class BeliefsSaid(msgspec.Struct, frozen=True, tag_field="record", tag="said", array_like=True):
    """What it then had published."""

    beliefs: tuple[Belief, ...]


Record: TypeAlias = EventTold | BeliefsSaid
"""What follows the head of a file."""


def without_bulk(event: Event) -> Event:
    """The event without particles and beams."""
    match event:
        case ReportArrived(worker, report):
            return ReportArrived(worker, _report(report))
        case ScanArrived(scan):
            return ScanArrived(without_beams(scan))
        case HistoryArrived(scans):
            return HistoryArrived(tuple(map(without_beams, scans)))
        case CheckpointHeard(checkpoint):
            return CheckpointHeard(_checkpoint(checkpoint))
        case WorkerToldState(worker, told):
            return WorkerToldState(worker, _told(told))
        case _:
            return event


def started_without_bulk(started: Started) -> Started:
    """The same without particles."""
    return replace(started, known=started.known and _checkpoint(started.known))


def no_particles(particles: Particles) -> Particles:
    """An empty cloud of the same step."""
    return replace(particles, map_from_robot=NO_POSES, log_weights=NO_WEIGHTS)


def without_beams(scan: Scan) -> Scan:
    """The scan without its ranges."""
    return replace(scan, ranges=NO_BEAMS, others=())


def _report(report: Report) -> Report:
    if isinstance(report, ElsewhereReport):
        return report
    if isinstance(report, SearchReport):
        return replace(report, places=_without_particles(report.places))
    if report.snapshot is None and not report.parts:
        return report
    return replace(
        report,
        snapshot=report.snapshot and no_particles(report.snapshot),
        parts=tuple(map(_place, report.parts)),
    )


def _without_particles(found: FoundPlaces) -> FoundPlaces:
    none = ArrayBlob.of(np.zeros(len(found), np.int32), "int32")
    return replace(found, count=none, particles=NO_PARTICLES)


def _place(place: Place) -> Place:
    return replace(place, sample=no_particles(place.sample))


def _told(told: Told) -> Told:
    return replace(
        told,
        holds=tuple(map(_assignment, told.holds)),
        checkpoint=told.checkpoint and _checkpoint(told.checkpoint),
        reports=tuple(map(_report, told.reports)),
        earlier=tuple(map(_checkpoint, told.earlier)),
        copies=tuple(map(_assignment, told.copies)),
    )


def _assignment(held: Assignment) -> Assignment:
    return replace(held, job=_job(held.job)) if isinstance(held.job, TrackJob) else held


def _job(job: TrackJob) -> TrackJob:
    return replace(job, start=no_particles(job.start))


def _checkpoint(checkpoint: Checkpoint) -> Checkpoint:
    """One whose state cannot be read stays as it is: it is refused again."""
    try:
        state = from_bytes(checkpoint.state)
    except ValueError:
        return checkpoint
    jobs = tuple(map(_job_state, state.jobs))
    return replace(checkpoint, state=to_bytes(replace(state, jobs=jobs)))


def _job_state(state: JobState) -> JobState:
    """Of a cluster as if its worker held the particles."""
    return replace(state, job=None) if isinstance(state.job, TrackJob) else state
