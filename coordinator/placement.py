"""Which worker does which job: told who is alive, answers with work orders.

A job has an epoch that rises each time it changes hands, so that a slow or resurrected worker
cannot vote: its reports carry the old one.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

import msgspec

from particle_filter.settings import FilterSettings
from protocol.work import Assignment, OrderAnswer, Particles, SearchJob, TrackJob, WorkOrder

RESEND_AFTER_NS = 500_000_000


@dataclass
class PlacedJob:
    """A job, who does it, and from where another could carry on."""

    job: TrackJob | SearchJob
    epoch: int = 0
    worker: str | None = None
    placed_ns: int = 0
    reported: bool = False


@dataclass
class WorkerRecord:
    """What a live worker has been told."""

    order: int = 0
    sent_ns: int = -RESEND_AFTER_NS
    answered: bool = True
    changed: bool = True
    known: set[tuple[str, int]] = field(default_factory=set)
    """(job id, epoch) that the worker has confirmed."""


class Placement:
    """Spreads jobs evenly over live workers and keeps what is needed to place them again."""

    def __init__(self, sender: str, settings: FilterSettings, snapshot_every_steps: int) -> None:
        self._sender = sender
        self._settings: dict[str, object] = msgspec.to_builtins(settings)
        self._snapshot_every_steps = snapshot_every_steps
        self._workers: dict[str, WorkerRecord] = {}
        self._jobs: dict[str, PlacedJob] = {}
        self._orders = 0
        self._epochs = 0
        self.map_digest = ""

    @property
    def workers(self) -> dict[str, tuple[str, ...]]:
        """Live workers and their jobs."""
        return {
            name: tuple(job_id for job_id, job in self._jobs.items() if job.worker == name)
            for name in sorted(self._workers)
        }

    def begin(self, jobs: dict[str, TrackJob | SearchJob]) -> None:
        """New jobs, to be placed."""
        self._jobs |= {job_id: PlacedJob(job) for job_id, job in jobs.items()}

    def end(self, job_ids: Iterable[str]) -> None:
        """Jobs that are over."""
        for job_id in job_ids:
            ended = self._jobs.pop(job_id, None)
            if ended is not None and ended.worker in self._workers:
                self._workers[ended.worker].changed = True

    def joined(self, worker: str) -> None:
        """A worker appeared; one that was known has started anew and knows nothing."""
        if worker in self._workers:
            self.left(worker)
        self._workers[worker] = WorkerRecord()

    def returned(self, worker: str) -> None:
        """A worker that could not be reached is back: its next answer tells what it still does."""
        self._workers[worker].changed = True

    def left(self, worker: str) -> None:
        """A worker is gone: its jobs go to others, from their last state."""
        self._workers.pop(worker, None)
        for job in self._jobs.values():
            if job.worker == worker:
                job.worker = None

    def is_current(self, job_id: str, epoch: int) -> bool:
        """Whether a report comes from the worker that has the job now."""
        job = self._jobs.get(job_id)
        return job is not None and job.epoch == epoch and job.worker is not None

    def is_of_another(self, job_id: str, epoch: int, worker: str) -> bool:
        """Whether a report claims a job's current epoch, but another worker has the job."""
        job = self._jobs.get(job_id)
        return job is not None and job.epoch == epoch and job.worker not in (None, worker)

    def placed_ns(self, job_id: str) -> int:
        """When the job was given to its worker; 0 when nobody has it."""
        job = self._jobs.get(job_id)
        return job.placed_ns if job is not None and job.worker is not None else 0

    def reported(self, job_id: str, snapshot: Particles | None) -> None:
        """A job reported; a snapshot is where another worker would carry on."""
        job = self._jobs[job_id]
        job.reported = True
        if snapshot is not None and isinstance(job.job, TrackJob):
            job.job = TrackJob(cluster=job.job.cluster, start=snapshot, exact=True)

    def answered(self, worker: str, answer: OrderAnswer) -> None:
        """A worker answered an order."""
        record = self._workers.get(worker)
        if record is None:
            return
        record.known = {(job_id, epoch) for job_id, epoch, _ in answer.jobs}
        own = {(job_id, job.epoch) for job_id, job in self._jobs.items() if job.worker == worker}
        taken = answer.order == record.order and not answer.problem
        # One started anew while nobody could see it answers without the jobs it should keep.
        record.answered = taken and (own <= record.known or record.changed)

    def orders(self, now_ns: int) -> list[tuple[str, WorkOrder]]:
        """Place what has no worker, even out, and tell every worker what is news to it."""
        if not self._workers:
            return []
        self._place_all(now_ns)
        self._even_out(now_ns)
        due = []
        for name, record in sorted(self._workers.items()):
            unanswered = not record.answered and now_ns - record.sent_ns >= RESEND_AFTER_NS
            if record.changed or unanswered:
                due.append((name, self._order(name, record, now_ns)))
        return due

    def _place_all(self, now_ns: int) -> None:
        for _, job in sorted(self._jobs.items()):
            if job.worker is None:
                self._give(job, self._least_loaded(), now_ns)

    def _even_out(self, now_ns: int) -> None:
        """Move a job from a worker that has two more than another; searches only before work."""
        for _ in range(len(self._jobs)):
            load = self._load()
            most, least = max(load, key=lambda n: (load[n], n)), self._least_loaded()
            movable = [
                job
                for _, job in sorted(self._jobs.items())
                if job.worker == most and (isinstance(job.job, TrackJob) or not job.reported)
            ]
            if load[most] - load[least] < 2 or not movable:
                return
            self._workers[most].changed = True
            self._give(movable[0], least, now_ns)

    def _load(self) -> dict[str, int]:
        load = dict.fromkeys(sorted(self._workers), 0)
        for job in self._jobs.values():
            if job.worker is not None:
                load[job.worker] += 1
        return load

    def _least_loaded(self) -> str:
        load = self._load()
        return min(load, key=lambda name: (load[name], name))

    def _give(self, job: PlacedJob, worker: str, now_ns: int) -> None:
        self._epochs += 1
        job.epoch, job.worker, job.placed_ns = self._epochs, worker, now_ns
        self._workers[worker].changed = True

    def _order(self, name: str, record: WorkerRecord, now_ns: int) -> WorkOrder:
        self._orders += 1
        record.order, record.sent_ns = self._orders, now_ns
        record.answered = record.changed = False
        own = sorted((job_id, job) for job_id, job in self._jobs.items() if job.worker == name)
        known = [(job_id, job) for job_id, job in own if (job_id, job.epoch) in record.known]
        return WorkOrder(
            sender=self._sender,
            order=record.order,
            map_digest=self.map_digest,
            filter_settings=self._settings,
            snapshot_every_steps=self._snapshot_every_steps,
            keep=tuple((job_id, job.epoch) for job_id, job in known),
            begin=tuple(
                Assignment(job_id=job_id, epoch=job.epoch, job=job.job)
                for job_id, job in own
                if (job_id, job.epoch) not in record.known
            ),
        )
