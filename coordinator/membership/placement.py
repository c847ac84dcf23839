"""Which worker does which job: told who is alive, answers with work orders.

A job has an epoch that rises each time it changes hands, so that a slow or resurrected worker
cannot vote: its reports carry the old one.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import msgspec

from coordinator.checkpoint import JobState
from coordinator.membership.straggler_policy import StragglerPolicy
from particle_filter.settings import FilterSettings
from protocol.work import Assignment, OrderAnswer, Particles, SearchJob, TrackJob, WorkOrder

RESEND_AFTER_NS = 500_000_000
MISSED_NS = 1_500_000_000
"""More than the longest pause between two tries to connect, less than a new job is waited for."""
HAND_OVER_NS = 2_000_000_000
"""A job that has just been given to a worker is waited for so long."""


@dataclass
class PlacedJob:
    """A job, who does it, and from where another could carry on."""

    job: TrackJob | SearchJob
    epoch: int = 0
    worker: str | None = None
    placed_ns: int = 0
    reported: bool = False
    in_step: bool = False
    """Its worker has reported a step in time: what has been handed over has arrived."""


@dataclass
class WorkerRecord:
    """What a live worker has been told."""

    order: int = 0
    sent_ns: int = -RESEND_AFTER_NS
    answered: bool = True
    changed: bool = True
    known: set[tuple[str, int]] = field(default_factory=set)
    """(job id, epoch) that the worker has confirmed."""
    silent_until_ns: int = 0
    """It is being asked what it does, and gets no order before."""


class Placement:
    """Spreads jobs evenly over live workers and keeps what is needed to place them again."""

    def __init__(self, sender: str, settings: FilterSettings, snapshot_every_steps: int) -> None:
        self._sender = sender
        self._term = 0
        self._settings: dict[str, object] = msgspec.to_builtins(settings)
        self._snapshot_every_steps = snapshot_every_steps
        self._workers: dict[str, WorkerRecord] = {}
        self._jobs: dict[str, PlacedJob] = {}
        self._missed_until_ns: dict[str, int] = {}
        """Workers that have jobs by a checkpoint, but are not here yet."""
        self._stragglers = StragglerPolicy()
        self._orders = 0
        self._epochs = 0
        self._settled = False
        """Nothing has changed since `orders` had nothing to do, and time alone changes nothing."""
        self.map_digest = ""

    @property
    def workers(self) -> dict[str, tuple[str, ...]]:
        """Live workers and their jobs."""
        return {
            name: tuple(job_id for job_id, job in self._jobs.items() if job.worker == name)
            for name in sorted(self._workers)
        }

    def has(self, worker: str) -> bool:
        """Whether a worker is there."""
        return worker in self._workers

    def misses(self, worker: str) -> bool:
        """Whether a worker that is not here yet has jobs by a checkpoint."""
        return worker in self._missed_until_ns

    def rule(self, term: int) -> None:
        """Begin a term: its epochs stand above those of all terms before."""
        self._term, self._epochs = term, max(term, self._epochs)

    def state(self) -> tuple[JobState, ...]:
        """All jobs as they are handed on: with particles where no worker is known to hold them."""
        return tuple(
            JobState(job_id, job.epoch, job.worker, None if self._is_held(job_id, job) else job.job)
            for job_id, job in self._jobs.items()
        )

    def restore(
        self, jobs: Iterable[JobState], rebuilt: Callable[[str], TrackJob], now_ns: int
    ) -> None:
        """Take over another's jobs; workers that are not here yet keep theirs for a while.

        Args:
            jobs: as `state` told.
            rebuilt: makes a job of a cluster whose particles only its worker holds.
            now_ns: by the clock of all events.
        """
        self._settled = False
        self._jobs = {
            job.job_id: PlacedJob(
                job.job or rebuilt(job.job_id), job.epoch, job.worker, now_ns, reported=True
            )
            for job in jobs
        }
        self._missed_until_ns = {
            job.worker: now_ns + MISSED_NS
            for job in self._jobs.values()
            if job.worker is not None and job.worker not in self._workers
        }
        for record in self._workers.values():
            record.changed, record.known = True, set()

    def held(self, worker: str, holds: Iterable[Assignment], now_ns: int) -> None:
        """A worker tells which jobs it has, and from where another could carry on."""
        self._settled = False
        record = self._workers[worker]
        record.changed, record.silent_until_ns = True, 0
        for held in holds:
            job = self._jobs.get(held.job_id)
            if job is None or held.epoch < job.epoch:
                continue
            job.epoch, job.worker, job.placed_ns = held.epoch, worker, now_ns
            job.job = held.job
            record.known.add((held.job_id, held.epoch))

    def begin(self, jobs: dict[str, TrackJob | SearchJob]) -> None:
        """New jobs, to be placed."""
        self._settled &= not jobs
        self._jobs |= {job_id: PlacedJob(job) for job_id, job in jobs.items()}

    def end(self, job_ids: Iterable[str]) -> None:
        """Jobs that are over."""
        for job_id in job_ids:
            ended = self._jobs.pop(job_id, None)
            self._settled &= ended is None
            if ended is not None and ended.worker in self._workers:
                self._workers[ended.worker].changed = True

    def joined(self, worker: str, silent_until_ns: int = 0) -> None:
        """A worker appeared; one that was known has started anew and knows nothing."""
        self._settled = False
        if worker in self._workers:
            self.left(worker)
        self._missed_until_ns.pop(worker, None)
        self._workers[worker] = WorkerRecord(silent_until_ns=silent_until_ns)

    def returned(self, worker: str) -> None:
        """A worker that could not be reached is back: its next answer tells what it still does."""
        self._settled = False
        self._workers[worker].changed = True

    def left(self, worker: str) -> None:
        """A worker is gone: its jobs go to others, from their last state."""
        self._settled = False
        self._workers.pop(worker, None)
        self._stragglers.forget(worker)
        self._take_jobs(worker)

    def _miss_no_longer(self, now_ns: int) -> None:
        for worker in [w for w, until_ns in self._missed_until_ns.items() if until_ns <= now_ns]:
            del self._missed_until_ns[worker]
            self._take_jobs(worker)

    def _take_jobs(self, worker: str) -> None:
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
        """When the job was given to its worker; 0 when nobody has it, or it has arrived there."""
        job = self._jobs.get(job_id)
        return job.placed_ns if job is not None and job.worker and not job.in_step else 0

    def waited_for(self, job_ids: Iterable[str]) -> list[str]:
        """Those jobs whose reports hold a step up: of silent workers only the first time."""
        return [
            job_id
            for job_id in job_ids
            if (job := self._jobs.get(job_id)) is None
            or job.worker is None
            or self._stragglers.waits_for(job.worker)
        ]

    def step_decided(self, expected: Iterable[str], missing: Iterable[str], now_ns: int) -> None:
        """A step was decided; workers that again have not reported in time lose their jobs.

        A search has steps that take longer than a deadline, so its workers are spared.
        """
        searching = {j.worker for j in self._jobs.values() if isinstance(j.job, SearchJob)}
        owed = {job_id: self._jobs[job_id] for job_id in expected if job_id in self._jobs}
        late = {
            job.worker
            for job_id in missing
            if (job := owed.pop(job_id, None))
            and job.worker
            and now_ns >= job.placed_ns + HAND_OVER_NS
        }
        reported = {job.worker for job in owed.values() if job.worker}
        blamed = {worker for worker in late if worker not in searching}
        for worker in self._stragglers.step_decided(reported, blamed, now_ns):
            self._settled = False
            self._take_jobs(worker)
            self._workers[worker].changed = True

    def reported(self, job_id: str, snapshot: Particles | None, *, in_time: bool) -> None:
        """A job reported; a snapshot is where another worker would carry on."""
        job = self._jobs[job_id]
        job.reported = True
        job.in_step |= in_time
        if job.worker is not None:
            self._stragglers.heard(job.worker, in_time=in_time)
        if snapshot is not None and isinstance(job.job, TrackJob):
            job.job = TrackJob(cluster=job.job.cluster, start=snapshot, exact=True)

    def answered(self, worker: str, answer: OrderAnswer) -> None:
        """A worker answered an order."""
        record = self._workers.get(worker)
        if record is None:
            return
        self._settled = False
        record.known = {(job_id, epoch) for job_id, epoch, _ in answer.jobs}
        own = {(job_id, job.epoch) for job_id, job in self._jobs.items() if job.worker == worker}
        taken = answer.order == record.order and not answer.problem
        # One started anew while nobody could see it answers without the jobs it should keep.
        record.answered = taken and (own <= record.known or record.changed)

    def orders(self, now_ns: int) -> list[tuple[str, WorkOrder]]:
        """Place what has no worker, even out, and tell every worker what is news to it."""
        if self._settled:
            return []
        self._miss_no_longer(now_ns)
        told = [name for name, r in sorted(self._workers.items()) if r.silent_until_ns <= now_ns]
        if not told:
            return []
        rested = [name for name in told if self._may_work(name, now_ns)]
        able = rested or told
        self._place_all(able, now_ns)
        self._even_out(able, now_ns)
        due = []
        for name in told:
            record = self._workers[name]
            unanswered = not record.answered and now_ns - record.sent_ns >= RESEND_AFTER_NS
            if record.changed or unanswered:
                due.append((name, self._order(name, record, now_ns)))
        self._settled = len(rested) == len(self._workers) and self._is_settled()
        return due

    def _is_settled(self) -> bool:
        """Whether, with all workers able, all has been placed, evened out, told and answered."""
        load = self._load(list(self._workers)).values()
        return (
            not self._missed_until_ns
            and all(record.answered for record in self._workers.values())
            and all(job.worker is not None for job in self._jobs.values())
            and max(load) - min(load) < 2
        )

    def _may_work(self, worker: str, now_ns: int) -> bool:
        answers = self._workers[worker].answered
        return self._stragglers.may_work(worker, now_ns, answers=answers)

    def _is_held(self, job_id: str, job: PlacedJob) -> bool:
        """Whether a worker is known to have a cluster's particles."""
        record = self._workers.get(job.worker) if job.worker is not None else None
        known = record is not None and (job_id, job.epoch) in record.known
        return known and isinstance(job.job, TrackJob)

    def _place_all(self, told: list[str], now_ns: int) -> None:
        for _, job in sorted(self._jobs.items()):
            if job.worker is None:
                self._give(job, self._least_loaded(told), now_ns)

    def _even_out(self, told: list[str], now_ns: int) -> None:
        """Move a job from a worker that has two more than another; searches only before work."""
        for _ in range(len(self._jobs)):
            load = self._load(told)
            most, least = max(load, key=lambda n: (load[n], n)), self._least_loaded(told)
            movable = [
                job
                for _, job in sorted(self._jobs.items())
                if job.worker == most and (isinstance(job.job, TrackJob) or not job.reported)
            ]
            if load[most] - load[least] < 2 or not movable:
                return
            self._workers[most].changed = True
            self._give(movable[0], least, now_ns)

    def _load(self, told: list[str]) -> dict[str, int]:
        load = dict.fromkeys(told, 0)
        for job in self._jobs.values():
            if job.worker in load:
                load[job.worker] += 1
        return load

    def _least_loaded(self, told: list[str]) -> str:
        load = self._load(told)
        return min(load, key=lambda name: (load[name], name))

    def _give(self, job: PlacedJob, worker: str, now_ns: int) -> None:
        self._epochs += 1
        job.epoch, job.worker, job.placed_ns = self._epochs, worker, now_ns
        job.in_step = False
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
            term=self._term,
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
