"""Jobs, their workers, and snapshots from which other workers could continue.

A job's epoch rises each time it changes hands. A slow or resurrected worker cannot vote: its
reports carry the old epoch.
"""

from collections.abc import Callable, Collection, Container, Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

from msgspec import Meta
from msgspec.structs import replace

from coordinator.part import FEW, Part
from protocol.message import Id, Number
from protocol.names import LONGEST_NAME, NAME_PATTERN
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
    """An order to give a job to another worker."""

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


WorkerName = Annotated[str, Meta(pattern=NAME_PATTERN, max_length=LONGEST_NAME)]


class PlacedJob(Part):
    """A job, its worker, and a snapshot from which another worker could continue."""

    local: ClassVar = frozenset({"placed_ns", "reported", "in_step", "term", "is_handed_on"})
    job: Job | None
    """None in a state that is handed on: the worker holds the particles."""
    epoch: Number = 0
    worker: WorkerName | None = None
    """None: the job waits for one."""
    placed_ns: int = 0
    reported: bool = False
    in_step: bool = False
    """The worker has reported a step in time, so it has received the job."""
    term: int = 0
    """Term of the coordinator that gave the job to its worker."""
    is_handed_on: bool = False
    """Whether another coordinator began the job."""

    def is_held_as(self, held: Assignment) -> bool:
        """Return whether a worker's assignment of the same id is this job.

        The previous coordinator may have given the job to that worker after it published its state.
        A coordinator that continued from an earlier state, or from none, reused the same ids.
        """
        given_since = self.is_handed_on and held.term == self.term and held.epoch > self.epoch
        return held.epoch == self.epoch or given_since


class Jobs(Part):
    """All jobs that are to be done; each has one worker, or waits for one."""

    local: ClassVar = frozenset({"newest_epoch", "missed_until_ns"})
    placed: Annotated[dict[Id, PlacedJob], FEW] = {}
    newest_epoch: int = 0
    missed_until_ns: dict[str, int] = {}
    """Workers that have jobs by another coordinator's state, but have not appeared yet."""

    def get(self, job_id: str) -> PlacedJob | None:
        """Return a job; None if it is over or never was."""
        return self.placed.get(job_id)

    def assignment(self, job_id: str) -> Assignment:
        """Return a job as it is given to its worker."""
        job = self.placed[job_id]
        assert job.job is not None  # only in a state that is handed on
        return Assignment(job_id=job_id, epoch=job.epoch, job=job.job, term=job.term)

    def by_worker(self) -> dict[str | None, dict[str, int]]:
        """Each worker's jobs and their epochs, in the order in which they began.

        Those of None wait for a worker.
        """
        found: dict[str | None, dict[str, int]] = {}
        for job_id, job in self.placed.items():
            found.setdefault(job.worker, {})[job_id] = job.epoch
        return found

    def searching(self) -> set[str | None]:
        """Workers with a shard of a search."""
        return {job.worker for job in self.shards().values()}

    def shards(self) -> dict[str, PlacedJob]:
        """Return the jobs of the running search, by id."""
        return {
            job_id: job for job_id, job in self.placed.items() if isinstance(job.job, SearchJob)
        }

    # --- how they begin, change hands and end

    def begin(self, jobs: Mapping[str, Job]) -> None:
        """Add jobs, to be placed."""
        self.placed |= {job_id: PlacedJob(job) for job_id, job in jobs.items()}

    def end(self, job_ids: Iterable[str]) -> None:
        for job_id in job_ids:
            self.placed.pop(job_id, None)

    def resize(self, job_id: str, particles: int, first_step: int) -> str | None:
        """Track a cluster with another number of particles; returns the job's worker, if any."""
        job = self.placed[job_id]
        assert isinstance(job.job, TrackJob)  # only clusters have a number of particles
        job.job = replace(job.job, particles=particles, particles_from=first_step)
        return job.worker

    def may_move(self, job_id: str) -> bool:
        """Return whether a job may move from a healthy worker: a search only before it reports."""
        job = self.placed[job_id]
        return not isinstance(job.job, SearchJob) or not job.reported

    def may_be_tried(self, job_id: str) -> bool:
        """Return whether a worker that has never reported may try the job: no search."""
        return not isinstance(self.placed[job_id].job, SearchJob)

    def carry_out(self, moves: Iterable[Move], term: int, now_ns: int) -> None:
        """Give jobs to other workers; epochs stand above those of all terms before."""
        for move in moves:
            job = self.placed[move.job_id]
            self.newest_epoch = max(self.newest_epoch, term) + 1
            job.epoch, job.worker, job.placed_ns = self.newest_epoch, move.worker, now_ns
            job.term, job.in_step = term, False

    def take_from(self, worker: str) -> None:
        """Let the jobs of a worker that is gone or too slow wait for another worker."""
        for job in self.placed.values():
            if job.worker == worker:
                job.worker = None

    def reported(self, report: Report, *, in_time: bool) -> None:
        """Take a job's report, and its snapshot, from which another worker could continue."""
        job = self.placed[report.job_id]
        job.reported = True
        job.in_step |= in_time
        snapshot = report.snapshot if isinstance(report, TrackReport) else None
        if snapshot is not None and isinstance(job.job, TrackJob):
            job.job = replace(job.job, start=snapshot, exact=True)

    def step_applied(self, step: int) -> None:
        """Move the first step of the job `ElsewhereJob` past an applied step."""
        for job in self.placed.values():
            if isinstance(job.job, ElsewhereJob) and job.job.first_step <= step:
                job.job = ElsewhereJob(first_step=step + 1)

    # --- whose reports count, and how long they are waited for

    def is_current(self, job_id: str, epoch: int) -> bool:
        """Return whether a report is of the job's present epoch."""
        job = self.placed.get(job_id)
        return job is not None and job.epoch == epoch and job.worker is not None

    def is_of_another(self, job_id: str, epoch: int, worker: str) -> bool:
        """Return whether a report has the present epoch of a job of another worker."""
        job = self.placed.get(job_id)
        return job is not None and job.epoch == epoch and job.worker not in (None, worker)

    def placed_ns(self, job_id: str) -> int:
        """Return when the job was given to its worker.

        0 if it has no worker, or if the worker has since reported one of its steps in time.
        """
        job = self.placed.get(job_id)
        return job.placed_ns if job is not None and job.worker and not job.in_step else 0

    # --- from one coordinator to the next

    def without_held(self, is_held: Callable[[str, PlacedJob], bool]) -> "Jobs":
        """Return the jobs without the particles of clusters for which `is_held` is true."""
        return Jobs(
            {
                job_id: replace(job, job=None) if is_held(job_id, job) else job
                for job_id, job in self.placed.items()
            }
        )

    def resume(
        self,
        handed_on: "Jobs",
        rebuilt: Callable[[str], TrackJob],
        present: Container[str],
        now_ns: int,
        *,
        term: int,
    ) -> None:
        """Continue with another coordinator's jobs; absent workers keep theirs for a while.

        Args:
            handed_on: jobs in the other coordinator's state.
            rebuilt: makes the job of a cluster whose particles only its worker holds.
            present: workers that have appeared.
            now_ns: time by the clock of all events [ns].
            term: the other coordinator's term.
        """
        self.placed = {
            job_id: PlacedJob(
                job.job or rebuilt(job_id),
                job.epoch,
                job.worker,
                now_ns,
                reported=True,
                term=term,
                is_handed_on=True,
            )
            for job_id, job in handed_on.placed.items()
        }
        self.missed_until_ns = {
            job.worker: now_ns + MISSED_NS
            for job in self.placed.values()
            if job.worker is not None and job.worker not in present
        }

    def misses(self, worker: str) -> bool:
        return worker in self.missed_until_ns

    def came(self, worker: str) -> None:
        self.missed_until_ns.pop(worker, None)

    def miss_no_longer(self, now_ns: int) -> None:
        """Take the jobs from workers that have not appeared in time."""
        for worker in [w for w, until_ns in self.missed_until_ns.items() if until_ns <= now_ns]:
            del self.missed_until_ns[worker]
            self.take_from(worker)

    def held(self, worker: str, holds: Iterable[Assignment], now_ns: int) -> list[Assignment]:
        """Store the jobs and snapshots that a worker reports.

        Returns:
            The jobs that remain with the worker. The others have ended, belong to another worker
            by a newer epoch, or come from a coordinator whose state was not adopted.
        """
        kept = []
        for held in holds:
            job = self.placed.get(held.job_id)
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
