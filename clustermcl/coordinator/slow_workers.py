"""Time limits for workers that do not report, after which other workers get their jobs.

The first step without a worker's report waits for one deadline, later ones do not until it reports
again. A count of missed steps, which halves with each step in time, decides when it loses its jobs,
and for how long.

Workers that have reported come first. All others with one certificate, whose names differ only in
their number, count as one: else sixty that compute nothing would each delay a step.
"""

from collections.abc import Container, Mapping, Sequence, Set

from clustermcl.belief.part import Part
from clustermcl.coordinator.jobs import PlacedJob
from clustermcl.protocol.work import SearchJob

GIVEN_UP_AFTER = 3
"""A worker loses its jobs at this count of missed steps."""
GIVEN_UP_LATER = 10
"""The same while all workers are slow."""
FIRST_PAUSE_NS = 2_000_000_000
"""Pause at the first of these counts; it doubles with each further missed step [ns]."""
LONGEST_PAUSE_NS = 60_000_000_000


class Punctuality(Part):
    """The steps that a worker has missed, and its pause, in which it gets no jobs."""

    missed: float = 0.0
    """Halved by each step in time."""
    silent: bool = False
    """Whether the worker has missed a step and has not reported since."""
    paused: bool = False
    pause_ends_ns: int = 0

    def pause(self, now_ns: int) -> None:
        doublings = min(int(self.missed) - GIVEN_UP_AFTER, 8)
        self.paused = True
        self.pause_ends_ns = now_ns + min(FIRST_PAUSE_NS << doublings, LONGEST_PAUSE_NS)


def origin(worker: str) -> str:
    """Return a worker's name without its number: the name of its machine and certificate."""
    prefix, _, number = worker.rpartition("-")
    return prefix if prefix and number.isdecimal() else worker


class StragglerPolicy(Part):
    """Decides which workers a step waits for, and which may have jobs."""

    records: dict[str, Punctuality] = {}
    """By name for workers that have reported, by origin for the others."""
    proven: set[str] = set()

    def _record_of(self, worker: str) -> Punctuality:
        return self.records.get(self._counted_as(worker)) or Punctuality()

    def on_report(self, worker: str) -> None:
        """Process a worker's report, which may be late: the worker is alive."""
        self.proven.add(worker)
        self._record_of(worker).silent = False

    def on_step_decided(
        self,
        reported: Set[str],
        missing: Set[str],
        now_ns: int,
        *,
        patient: bool = False,
        keep: Container[str | None] = (),
    ) -> list[str]:
        """Record which workers missed a step; return those that lose their jobs, but for `keep`.

        Workers are `missing` if they did not report all of their jobs in time, and have `reported`
        if they reported one. `patient`: all workers are slow.
        """
        if not reported:  # the network is slow then, not one worker
            return []
        for worker in self.records.keys() & reported:
            self.records[worker].missed /= 2
        most = GIVEN_UP_LATER if patient else GIVEN_UP_AFTER
        late: dict[str, list[str]] = {}
        for worker in sorted(missing - reported):
            late.setdefault(self._counted_as(worker), []).append(worker)
        given_up = []
        for name, workers in late.items():
            record = self.records.setdefault(name, Punctuality())
            record.silent = True
            movable = [worker for worker in workers if worker not in keep]
            record.missed += bool(movable)
            if movable and record.missed >= most:
                given_up += movable
                record.missed -= most - GIVEN_UP_AFTER
                record.pause(now_ns)
        return given_up

    def give_up(self, worker: str, now_ns: int) -> bool:
        """Give a worker no new jobs for a while; return whether it has never reported."""
        record = self.records.setdefault(self._counted_as(worker), Punctuality())
        record.missed = max(record.missed + 1, GIVEN_UP_AFTER)
        record.pause(now_ns)
        return worker not in self.proven

    def trusted(self, workers: Sequence[str]) -> list[str]:
        """Return the workers that get a full share of the jobs.

        These are the workers that have reported, and those of the same origin unless it was given
        up; before the first report, all.
        """
        known = {origin(worker) for worker in self.proven}
        given_up = {name for name, one in self.records.items() if one.missed >= GIVEN_UP_AFTER}
        return [
            worker
            for worker in workers
            if worker in self.proven
            or ((not known or origin(worker) in known) and origin(worker) not in given_up)
        ]

    def _counted_as(self, worker: str) -> str:
        return worker if worker in self.proven else origin(worker)

    def waits_for(self, worker: str) -> bool:
        return not self._record_of(worker).silent

    def may_work(self, worker: str, now_ns: int, *, answers: bool) -> bool:
        """Return whether a worker may have jobs.

        After a pause it may if it `answers`: it has answered its last order, so it is not frozen.
        """
        record = self._record_of(worker)
        if record.paused and answers and now_ns >= record.pause_ends_ns:
            record.paused = False
            record.silent = worker not in self.proven  # no step waits for a trial
        return not record.paused

    def forget(self, worker: str) -> None:
        """Forget a worker that is gone; a later one of the same name has reported nothing."""
        if worker in self.proven:
            self.proven.discard(worker)
            self.records.pop(worker, None)


STEPS = 5
"""A shard is silent when the others have reported this number of steps each since its report."""
SHORTEST_NS = 3_000_000_000
"""A shard is given up after this time at the earliest [ns]."""
TIMES_THE_OTHERS = 3
"""A shard may take this multiple of the slowest other shard's time for its first step."""
LONGEST_NS = 30_000_000_000
"""A shard is given up after this time in any case; doubled each time, as maps may be large [ns]."""


class ShardReports(Part):
    """The reports of a shard, and the silence of its present worker."""

    reports: int = 0
    step: int = -1
    took_ns: int = 0
    """Duration of its first step [ns]; 0: it has reported none."""
    times_given_up: int = 0
    watched: tuple[int, int] | None = None
    """Epoch and number of reports when the present silence began; None: it is not watched."""
    others: int = 0
    """Number of reports of other workers' shards when it began."""
    since_ns: int = 0


class SilentShards(Part):
    """Decides which shards of a search another worker should have.

    A step of a search may take long, depending on the map. So the time of a shard is compared with
    the times of the others. A limit in seconds holds in any case.
    """

    records: dict[str, ShardReports] = {}

    def on_report(self, job_id: str, step: int) -> None:
        record = self.records.setdefault(job_id, ShardReports())
        record.reports += 1
        record.step = max(step, record.step)

    def forgive(self) -> None:
        """Begin all silences again: reports were lost, or this process was stopped."""
        for record in self.records.values():
            record.watched = None

    def given_up(self, shards: Mapping[str, PlacedJob], newest_step: int, now_ns: int) -> list[str]:
        """Return the shards of the running search that have been silent for too long.

        No report is due after `newest_step`, the newest step whose scan has arrived.
        """
        self.records = {job_id: self.records.get(job_id, ShardReports()) for job_id in shards}
        return [job_id for job_id in shards if self._is_silent(job_id, shards, newest_step, now_ns)]

    def _is_silent(
        self, job_id: str, shards: Mapping[str, PlacedJob], newest_step: int, now_ns: int
    ) -> bool:
        placed, record = shards[job_id], self.records[job_id]
        others = [self.records[one] for one, job in shards.items() if job.worker != placed.worker]
        reported, watched = sum(other.reports for other in others), (placed.epoch, record.reports)
        first = placed.job.first_step if isinstance(placed.job, SearchJob) else 0
        owes = newest_step >= max(first, record.step + 1)
        if record.watched != watched or not owes or placed.worker is None:
            is_same_worker = record.watched is not None and record.watched[0] == placed.epoch
            if is_same_worker and record.reports and not record.took_ns:
                record.took_ns = now_ns - record.since_ns
            record.watched, record.others, record.since_ns = watched, reported, now_ns
            return False
        silent_ns = now_ns - record.since_ns
        took_ns = max((other.took_ns for other in others), default=0)
        is_overtaken = bool(others) and reported - record.others >= STEPS * len(others)
        is_silent = silent_ns >= LONGEST_NS << record.times_given_up or (
            is_overtaken and silent_ns >= max(SHORTEST_NS, TIMES_THE_OTHERS * took_ns)
        )
        record.times_given_up += is_silent
        return is_silent
