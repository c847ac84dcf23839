"""Jobs, their workers, and snapshots from which other workers could continue.

A job's epoch rises each time it changes hands. Reports of a replaced worker have the old epoch, so
they do not count.
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Annotated, ClassVar

from msgspec import Meta
from msgspec.structs import replace

from clustermcl.belief.part import FEW, Part
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.keys import LONGEST_NAME, NAME_PATTERN
from clustermcl.protocol.message import Id, Number
from clustermcl.protocol.work import (
    Assignment,
    ElsewhereJob,
    Job,
    Report,
    SearchJob,
    TrackJob,
    TrackReport,
)


def balanced(
    jobs: Mapping[str | None, Collection[str]],
    workers: Collection[str],
    may_move: Callable[[str], bool],
) -> dict[str, str]:
    """Return the new worker of each job that changes hands, by job id.

    Each waiting job, one of None, goes to the least loaded worker; then the load is balanced. A job
    moves only from a worker that has two more than another, so that it does not move back soon. Of
    equally loaded workers, the first by name gets a job and the last by name loses one. Jobs of
    workers that are not in `workers` stay where they are.
    """
    if not workers:
        return {}
    load = {worker: len(jobs.get(worker, ())) for worker in workers}
    moves: dict[str, str] = {}

    def give(job_id: str) -> None:
        least = min(load, key=lambda name: (load[name], name))
        load[least] += 1
        moves[job_id] = least

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


HAND_OVER_NS = 2_000_000_000
"""A step waits at least this long for a job that was just given to a worker [ns]."""
AWAITED_NS = 1_500_000_000
"""After a take-over, absent workers keep their jobs for this time: longer than the longest pause
between two attempts to connect, shorter than `HAND_OVER_NS`."""

WorkerName = Annotated[str, Meta(pattern=NAME_PATTERN, max_length=LONGEST_NAME)]


class PlacedJob(Part):
    """A job, its worker, and a snapshot from which another worker could continue."""

    local: ClassVar = frozenset({"placed_ns", "reported", "in_step", "term", "is_handed_on"})
    job: Job | None
    """None only in a transferred state, if the worker holds the particles."""
    epoch: Number = 0
    worker: WorkerName | None = None
    """None: the job waits for a worker."""
    placed_ns: int = 0
    reported: bool = False
    in_step: bool = False
    """Whether the present worker has reported a step in time, so it has received the job."""
    term: int = 0
    """Term of the coordinator that gave the job to its worker."""
    is_handed_on: bool = False
    """Whether another coordinator began the job."""


class Jobs(Part):
    """All jobs that are to be done; each has one worker, or waits for one."""

    local: ClassVar = frozenset({"newest_epoch", "applied_step", "awaited_until_ns"})
    placed: Annotated[dict[Id, PlacedJob], FEW] = {}
    newest_epoch: int = 0
    applied_step: int = -1
    """The last step applied by this coordinator."""
    awaited_until_ns: dict[str, int] = {}
    """Until when absent workers keep the jobs that the previous coordinator gave them [ns]."""

    def assignment(self, job_id: str) -> Assignment:
        job = self.placed[job_id]
        assert job.job is not None  # None only in a transferred state
        return Assignment(job_id=job_id, epoch=job.epoch, job=job.job, term=job.term)

    def by_worker(self) -> dict[str | None, dict[str, int]]:
        """Return the epochs of each worker's jobs by job id; of None: those that wait for one."""
        found: dict[str | None, dict[str, int]] = {}
        for job_id, job in self.placed.items():
            found.setdefault(job.worker, {})[job_id] = job.epoch
        return found

    def shards(self) -> dict[str, PlacedJob]:
        """Return the jobs of the running search, by id."""
        return {i: job for i, job in self.placed.items() if isinstance(job.job, SearchJob)}

    # --- begin, change hands and end

    def begin(self, jobs: Mapping[str, Job]) -> None:
        self.placed |= {job_id: PlacedJob(job) for job_id, job in jobs.items()}

    def end(self, job_ids: Iterable[str]) -> None:
        for job_id in job_ids:
            self.placed.pop(job_id, None)

    def may_move(self, job_id: str) -> bool:
        """Return whether a job may leave a healthy worker.

        A search that has reported may not, nor a cluster whose snapshot is of a step that is not
        applied yet: after a take-over only its worker has the reports up to that step.
        """
        placed = self.placed[job_id]
        match placed.job:
            case SearchJob():
                return not placed.reported
            case TrackJob(start=start):
                return start.step <= self.applied_step
        return True

    def move(self, moves: Mapping[str, str], term: int, now_ns: int) -> None:
        """Give jobs to workers; each gets an epoch above all epochs of earlier terms."""
        for job_id, worker in moves.items():
            job = self.placed[job_id]
            self.newest_epoch = max(self.newest_epoch, term) + 1
            job.epoch, job.worker, job.placed_ns = self.newest_epoch, worker, now_ns
            job.term, job.in_step = term, False

    def take_from(self, worker: str) -> None:
        for job in self.placed.values():
            if job.worker == worker:
                job.worker = None

    def on_report(self, report: Report, *, in_time: bool) -> None:
        """Store the snapshot of a report, from which another worker could continue."""
        job = self.placed[report.job_id]
        job.reported = True
        job.in_step |= in_time
        snapshot = report.snapshot if isinstance(report, TrackReport) else None
        if snapshot is not None and isinstance(job.job, TrackJob):
            job.job = replace(job.job, start=snapshot, exact=True)

    def step_applied(self, step: int) -> None:
        """Note an applied step, and move the first step of an `ElsewhereJob` past it."""
        self.applied_step = step
        for job in self.placed.values():
            if isinstance(job.job, ElsewhereJob) and job.job.first_step <= step:
                job.job = ElsewhereJob(first_step=step + 1)

    # --- which reports count, and how long they are waited for

    def refusal_of(self, report: Report, worker: str) -> Cause | None:
        """Return why a worker's report does not count, or None."""
        job = self.placed.get(report.job_id)
        if job is None or job.worker is None or job.epoch != report.epoch:
            return Cause.OLD_EPOCH
        return None if job.worker == worker else Cause.OTHER_JOB

    def placed_ns(self, job_id: str) -> int:
        """Return when the job was given to its worker [ns]; 0: it has since reported in time."""
        job = self.placed.get(job_id)
        return job.placed_ns if job is not None and job.worker and not job.in_step else 0

    # --- from one coordinator to the next

    def give_up_awaited(self, now_ns: int) -> None:
        for worker in [w for w, until_ns in self.awaited_until_ns.items() if until_ns <= now_ns]:
            del self.awaited_until_ns[worker]
            self.take_from(worker)

    def held(self, worker: str, holds: Iterable[Assignment], now_ns: int) -> list[Assignment]:
        """Store the jobs and snapshots that a worker reports; return those that it keeps."""
        kept = []
        for held in holds:
            if (job := self.placed.get(held.job_id)) is None:
                continue
            # The previous coordinator may have given it the job after it published its state. A
            # coordinator that continued from an earlier state, or from none, reused the same ids.
            given_since = job.is_handed_on and held.term == job.term and held.epoch > job.epoch
            if held.epoch != job.epoch and not given_since:
                continue
            job.epoch, job.worker, job.placed_ns = held.epoch, worker, now_ns
            match job.job, held.job:
                case _, ElsewhereJob():
                    pass  # the worker's copy may be ahead of the applied step
                case TrackJob(particles=particles, particles_from=first_step), TrackJob() as track:
                    # The order with the newest number of particles may have been lost.
                    job.job = replace(track, particles=particles, particles_from=first_step)
                case _:
                    job.job = held.job
            kept.append(held)
        return kept
