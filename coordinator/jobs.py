"""Which worker has which job, and from which snapshot another could continue.

A job's epoch rises each time it changes hands. A slow or resurrected worker cannot vote: its
reports carry the old epoch.
"""

from collections.abc import Callable, Collection, Container, Iterable, Mapping
from dataclasses import dataclass

import msgspec
from msgspec.structs import replace

from protocol.message import Id, Number
from protocol.work import (
    Assignment,
    ElsewhereJob,
    Job,
    Report,
    SearchJob,
    TrackJob,
    TrackReport,
)


@dataclass(frozen=True)
class Move:
    """A job gets another worker."""

    job_id: str
    worker: str


def balanced(
    jobs: Mapping[str | None, Collection[str]],
    workers: Collection[str],
    may_move: Callable[[str], bool],
) -> list[Move]:
    """Give each waiting job to the least loaded worker, then even out.

    A job moves only from a worker that has two more than another, so that it does not move back
    soon. Of equally loaded workers, the first by name gets a job and the last by name gives one
    away.

    Args:
        jobs: each worker's jobs by id; those of None wait for a worker.
        workers: workers that may get jobs; jobs of others stay where they are.
        may_move: whether a job may change hands while its worker is well.
    """
    if not workers:
        return []
    load = {worker: len(jobs.get(worker, ())) for worker in workers}
    moves = []

    def give(job_id: str) -> None:
        least = min(load, key=lambda name: (load[name], name))
        load[least] += 1
        moves.append(Move(job_id, least))

    for job_id in sorted(jobs.get(None, ())):
        give(job_id)
    movable: dict[str, list[str]] = {}
    while max(load.values()) - min(load.values()) >= 2:
        most = max(load, key=lambda name: (load[name], name))
        if most not in movable:
            movable[most] = sorted(filter(may_move, jobs[most]))
        if not movable[most]:
            break
        load[most] -= 1
        give(movable[most].pop(0))
    return moves


MISSED_NS = 1_500_000_000
"""More than the longest pause between two tries to connect, less than a new job is waited for."""
HAND_OVER_NS = 2_000_000_000
"""A step waits at least this long for a job that was just given to a worker [ns]."""


class JobState(msgspec.Struct, frozen=True):
    """One job and its worker, in the coordinator's state."""

    job_id: Id
    epoch: Number
    worker: str | None
    job: Job | None
    """None: a cluster whose particles its worker holds."""


@dataclass
class PlacedJob:
    """A job, who does it, and from where another could carry on."""

    job: Job
    epoch: int = 0
    worker: str | None = None
    placed_ns: int = 0
    reported: bool = False
    in_step: bool = False
    """Its worker has reported a step in time: what has been handed over has arrived."""
    term: int = 0
    """Of the coordinator that gave it to its worker."""
    is_handed_on: bool = False
    """Whether another coordinator began it."""

    def is_held_as(self, held: Assignment) -> bool:
        """Whether what a worker holds under this job's id is this job.

        Who handed it on may have given it to that worker since. Another coordinator that went on
        from an earlier state, or from none, gave its own jobs the same ids.
        """
        given_since = self.is_handed_on and held.term == self.term and held.epoch > self.epoch
        return held.epoch == self.epoch or given_since


class Jobs:
    """All jobs that are to be done; each has one worker, or waits for one."""

    def __init__(self) -> None:
        self._jobs: dict[str, PlacedJob] = {}
        self._newest_epoch = 0
        self._missed_until_ns: dict[str, int] = {}
        """Workers that have jobs by a checkpoint, but are not here yet."""

    def get(self, job_id: str) -> PlacedJob | None:
        """Return a job; None if it is over or never was."""
        return self._jobs.get(job_id)

    def assignment(self, job_id: str) -> Assignment:
        """A job as it is given to its worker."""
        job = self._jobs[job_id]
        return Assignment(job_id=job_id, epoch=job.epoch, job=job.job, term=job.term)

    def by_worker(self) -> dict[str | None, dict[str, int]]:
        """Each worker's jobs and their epochs, in the order in which they began.

        Those of None wait for a worker.
        """
        found: dict[str | None, dict[str, int]] = {}
        for job_id, job in self._jobs.items():
            found.setdefault(job.worker, {})[job_id] = job.epoch
        return found

    def searching(self) -> set[str | None]:
        """Workers with a shard of a search."""
        return {job.worker for job in self.shards().values()}

    def shards(self) -> dict[str, PlacedJob]:
        """Jobs of the search that runs."""
        return {job_id: job for job_id, job in self._jobs.items() if isinstance(job.job, SearchJob)}

    # --- how they begin, change hands and end

    def begin(self, jobs: Mapping[str, Job]) -> None:
        """Add jobs, to be placed."""
        self._jobs |= {job_id: PlacedJob(job) for job_id, job in jobs.items()}

    def end(self, job_ids: Iterable[str]) -> None:
        for job_id in job_ids:
            self._jobs.pop(job_id, None)

    def resize(self, job_id: str, particles: int, first_step: int) -> str | None:
        """Track a cluster with another number of particles; returns the job's worker, if any."""
        job = self._jobs[job_id]
        assert isinstance(job.job, TrackJob)  # only clusters have a number of particles
        job.job = replace(job.job, particles=particles, particles_from=first_step)
        return job.worker

    def may_move(self, job_id: str) -> bool:
        """Whether a job may change hands while its worker is well; a search only before work."""
        job = self._jobs[job_id]
        return not isinstance(job.job, SearchJob) or not job.reported

    def may_be_tried(self, job_id: str) -> bool:
        """Whether a worker that has never reported may try the job: all wait for a search."""
        return not isinstance(self._jobs[job_id].job, SearchJob)

    def carry_out(self, moves: Iterable[Move], term: int, now_ns: int) -> None:
        """Give jobs to other workers; epochs stand above those of all terms before."""
        for move in moves:
            job = self._jobs[move.job_id]
            self._newest_epoch = max(self._newest_epoch, term) + 1
            job.epoch, job.worker, job.placed_ns = self._newest_epoch, move.worker, now_ns
            job.term, job.in_step = term, False

    def take_from(self, worker: str) -> None:
        """A worker is gone or too slow: its jobs go to others, from their last state."""
        for job in self._jobs.values():
            if job.worker == worker:
                job.worker = None

    def reported(self, report: Report, *, in_time: bool) -> None:
        """Take a job's report, and its snapshot, from which another worker could continue."""
        job = self._jobs[report.job_id]
        job.reported = True
        job.in_step |= in_time
        snapshot = report.snapshot if isinstance(report, TrackReport) else None
        if snapshot is not None and isinstance(job.job, TrackJob):
            job.job = replace(job.job, start=snapshot, exact=True)

    def step_applied(self, step: int) -> None:
        """Move the first step of the job `ElsewhereJob` past an applied step."""
        for job in self._jobs.values():
            if isinstance(job.job, ElsewhereJob) and job.job.first_step <= step:
                job.job = ElsewhereJob(first_step=step + 1)

    # --- whose reports count, and how long they are waited for

    def is_current(self, job_id: str, epoch: int) -> bool:
        """Whether a report comes from the worker that has the job now."""
        job = self._jobs.get(job_id)
        return job is not None and job.epoch == epoch and job.worker is not None

    def is_of_another(self, job_id: str, epoch: int, worker: str) -> bool:
        """Whether a report claims a job's current epoch, but another worker has the job."""
        job = self._jobs.get(job_id)
        return job is not None and job.epoch == epoch and job.worker not in (None, worker)

    def placed_ns(self, job_id: str) -> int:
        """Return when the job was given to its worker; 0 without a worker, or if it has arrived."""
        job = self._jobs.get(job_id)
        return job.placed_ns if job is not None and job.worker and not job.in_step else 0

    # --- from one coordinator to the next

    def state(self, is_held: Callable[[str, PlacedJob], bool]) -> tuple[JobState, ...]:
        """Return all jobs, with particles unless `is_held` by their worker."""
        return tuple(
            JobState(job_id, job.epoch, job.worker, None if is_held(job_id, job) else job.job)
            for job_id, job in self._jobs.items()
        )

    def restore(
        self,
        jobs: Iterable[JobState],
        rebuilt: Callable[[str], TrackJob],
        present: Container[str],
        now_ns: int,
        *,
        term: int,
    ) -> None:
        """Continue with another coordinator's jobs; absent workers keep theirs for a while.

        Args:
            jobs: from its state.
            rebuilt: makes a job of a cluster whose particles only its worker holds.
            present: workers that are here.
            now_ns: by the clock of all events.
            term: of the other.
        """
        self._jobs = {
            job.job_id: PlacedJob(
                job.job or rebuilt(job.job_id),
                job.epoch,
                job.worker,
                now_ns,
                reported=True,
                term=term,
                is_handed_on=True,
            )
            for job in jobs
        }
        self._missed_until_ns = {
            job.worker: now_ns + MISSED_NS
            for job in self._jobs.values()
            if job.worker is not None and job.worker not in present
        }

    def misses(self, worker: str) -> bool:
        return worker in self._missed_until_ns

    def came(self, worker: str) -> None:
        self._missed_until_ns.pop(worker, None)

    def miss_no_longer(self, now_ns: int) -> None:
        """Take the jobs from workers that have not appeared in time."""
        for worker in [w for w, until_ns in self._missed_until_ns.items() if until_ns <= now_ns]:
            del self._missed_until_ns[worker]
            self.take_from(worker)

    def held(self, worker: str, holds: Iterable[Assignment], now_ns: int) -> list[Assignment]:
        """Take the jobs that a worker reports, with snapshots.

        Returns:
            Those of them that it has now; the others are over, another's by a newer epoch, or of a
            coordinator from whose state this one does not continue.
        """
        kept = []
        for held in holds:
            job = self._jobs.get(held.job_id)
            if job is None or not job.is_held_as(held):
                continue
            job.epoch, job.worker, job.placed_ns = held.epoch, worker, now_ns
            match job.job, held.job:
                case _, ElsewhereJob():
                    pass  # the worker's may be ahead of what is applied
                case TrackJob(particles=particles, particles_from=first_step), TrackJob() as track:
                    # The order with the newest number may have been lost.
                    job.job = replace(track, particles=particles, particles_from=first_step)
                case _:
                    job.job = held.job
            kept.append(held)
        return kept
