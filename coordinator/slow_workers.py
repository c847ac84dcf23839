"""Time limits for workers that do not report, after which other workers get their jobs.

The first step without a worker's report waits for one deadline. No later step waits for that
worker until it reports again, and after some more steps the worker loses its jobs. It gets jobs
again after a pause, which doubles each time; otherwise it would take and lose jobs forever.

Workers that have reported come first. All others with one certificate, whose names differ only in
their number, count as one worker. Otherwise sixty workers that answer orders and compute nothing
would each delay a step.
"""

from collections.abc import Mapping, Sequence, Set

from coordinator.jobs import PlacedJob
from coordinator.part import Part
from protocol.work import SearchJob

GIVEN_UP_AFTER = 3
"""A worker loses its jobs after this number of steps in a row without a report in time."""
GIVEN_UP_LATER = 10
"""The same number of steps while all workers are slow."""
FIRST_PAUSE_NS = 2_000_000_000
LONGEST_PAUSE_NS = 60_000_000_000
FORGOTTEN_AFTER_NS = 120_000_000_000
"""A worker's next pause is short again if the last one ended longer ago than this [ns]."""


class Punctuality(Part):
    """The steps that a worker has missed, and its pause."""

    missed: int = 0
    """Steps in a row."""
    silent: bool = False
    """Whether the worker has missed a step and has not reported since."""
    paused: bool = False
    pause_ns: int = FIRST_PAUSE_NS
    """Length of the next pause [ns]."""
    pause_ends_ns: int = 0
    """End of the last pause [ns]; 0: there was no pause."""


def origin(worker: str) -> str:
    """Return a worker's name without its number: the name of its machine and certificate."""
    prefix, _, number = worker.rpartition("-")
    return prefix if prefix and number.isdecimal() else worker


class StragglerPolicy(Part):
    """Decides which workers a step waits for, and which may have jobs."""

    records: dict[str, Punctuality] = {}
    """By name for workers that have reported, by origin for the others."""
    proven: set[str] = set()
    """Workers that have reported."""

    def on_report(self, worker: str, *, in_time: bool) -> None:
        """Process a worker's report; a late one only shows that the worker is alive."""
        self.proven.add(worker)
        record = self.records.get(worker)
        if record is not None:
            record.silent = False
            record.missed = 0 if in_time else record.missed

    def on_step_decided(
        self, reported: Set[str], missing: Set[str], now_ns: int, *, patient: bool = False
    ) -> list[str]:
        """Record who missed a step; return the workers that lose their jobs.

        Args:
            reported: workers that reported at least one of their jobs.
            missing: workers that did not report all of their jobs in time.
            now_ns: by the clock of all events.
            patient: whether all workers are slow.
        """
        if not reported:  # the network is slow then, not one worker
            return []
        late: dict[str, list[str]] = {}
        for worker in sorted(missing - reported):
            late.setdefault(self._counted_as(worker), []).append(worker)
        given_up = []
        for name, workers in late.items():
            record = self.records.setdefault(name, Punctuality())
            record.missed += 1
            record.silent = True
            if record.missed >= (GIVEN_UP_LATER if patient else GIVEN_UP_AFTER):
                given_up += workers
                self._pause(record, now_ns)
        return given_up

    def give_up(self, worker: str, now_ns: int) -> bool:
        """Give a worker no new jobs for a while; return whether it has never reported."""
        self._pause(self.records.setdefault(self._counted_as(worker), Punctuality()), now_ns)
        return worker not in self.proven

    def trusted(self, workers: Sequence[str]) -> list[str]:
        """Return the workers that get a full share of the jobs.

        These are the workers that have reported, and those of the same origin. Before the first
        report, all workers are trusted. An origin that was given up is not trusted.
        """
        known = {origin(worker) for worker in self.proven}
        paused = {name for name, record in self.records.items() if record.pause_ends_ns > 0}
        return [
            worker
            for worker in workers
            if worker in self.proven
            or ((not known or origin(worker) in known) and origin(worker) not in paused)
        ]

    def _counted_as(self, worker: str) -> str:
        return worker if worker in self.proven else origin(worker)

    def waits_for(self, worker: str) -> bool:
        record = self.records.get(self._counted_as(worker))
        return record is None or not record.silent

    def may_work(self, worker: str, now_ns: int, *, answers: bool) -> bool:
        """Return whether a worker may have jobs.

        Args:
            worker: name of the worker.
            now_ns: by the clock of all events.
            answers: whether the worker has answered its last order, so it is not frozen.
        """
        record = self.records.get(self._counted_as(worker))
        if record is None or not record.paused:
            return True
        if answers and now_ns >= record.pause_ends_ns:
            record.paused = False
            record.silent = worker not in self.proven  # no step waits for a trial
        return not record.paused

    def forget(self, worker: str) -> None:
        """Forget a worker that is gone; a later one of the same name has reported nothing."""
        if worker in self.proven:
            self.proven.discard(worker)
            self.records.pop(worker, None)

    def _pause(self, record: Punctuality, now_ns: int) -> None:
        if now_ns > record.pause_ends_ns + FORGOTTEN_AFTER_NS:
            record.pause_ns = FIRST_PAUSE_NS
        record.paused, record.missed = True, 0
        record.pause_ends_ns = now_ns + record.pause_ns
        record.pause_ns = min(2 * record.pause_ns, LONGEST_PAUSE_NS)


STEPS = 5
"""A shard is silent when the others have reported this number of steps each since its report."""
SHORTEST_NS = 3_000_000_000
"""A shard is given up after this time at the earliest [ns]."""
TIMES_THE_OTHERS = 3
"""A shard may take this multiple of the slowest other shard's time for its first step."""
LONGEST_NS = 30_000_000_000
"""A shard is given up after this time in any case; doubled each time, as maps may be large [ns]."""
PAUSE_NS = 1_000_000_000
"""If this process paused for longer, silence proves nothing [ns]."""


class Watch(Part):
    """A shard's last report from its present worker."""

    epoch: int
    reports: int
    """Number of the shard's reports."""
    others: int
    """Number of reports of other workers' shards at that time."""
    since_ns: int
    """When the report arrived, or the worker got the shard [ns]."""


class SilentShards(Part):
    """Decides which shards of a search another worker should have.

    A step of a search may take long, depending on the map. So the time of a shard is compared with
    the times of the others. A limit in seconds holds in any case.
    """

    reports: dict[str, int] = {}
    """Number of reports of each shard."""
    steps: dict[str, int] = {}
    """Newest step that each shard has reported."""
    took_ns: dict[str, int] = {}
    """Duration of the first step of each shard that has reported one [ns]."""
    times_given_up: dict[str, int] = {}
    watches: dict[str, Watch] = {}
    looked_ns: int = 0
    """When the shards were examined last [ns]."""

    def on_report(self, job_id: str, step: int) -> None:
        self.reports[job_id] = self.reports.get(job_id, 0) + 1
        self.steps[job_id] = max(step, self.steps.get(job_id, step))

    def given_up(self, shards: Mapping[str, PlacedJob], newest_step: int, now_ns: int) -> list[str]:
        """Return the shards that have been silent for too long.

        Args:
            shards: jobs of the running search.
            newest_step: the newest step whose scan has arrived; later reports are not due.
            now_ns: by the clock of all events.
        """
        if now_ns - self.looked_ns > PAUSE_NS:
            self.watches.clear()
        self.looked_ns = now_ns
        for known in (self.reports, self.steps, self.took_ns, self.times_given_up, self.watches):
            for job_id in known.keys() - shards.keys():
                del known[job_id]
        return [job_id for job_id in shards if self._is_silent(job_id, shards, newest_step, now_ns)]

    def _is_silent(
        self, job_id: str, shards: Mapping[str, PlacedJob], newest_step: int, now_ns: int
    ) -> bool:
        placed, reports = shards[job_id], self.reports.get(job_id, 0)
        others = [other for other, job in shards.items() if job.worker != placed.worker]
        heard = sum(self.reports.get(other, 0) for other in others)
        watch = self.watches.get(job_id)
        first = placed.job.first_step if isinstance(placed.job, SearchJob) else 0
        owes = newest_step >= max(first, self.steps.get(job_id, first - 1) + 1)
        if (
            watch is None
            or (watch.epoch, watch.reports) != (placed.epoch, reports)
            or not owes
            or placed.worker is None
        ):
            if watch is not None and watch.epoch == placed.epoch and reports:
                self.took_ns.setdefault(job_id, now_ns - watch.since_ns)
            self.watches[job_id] = Watch(placed.epoch, reports, heard, now_ns)
            return False
        silent_ns = now_ns - watch.since_ns
        times_given_up = self.times_given_up.get(job_id, 0)
        took_ns = max((self.took_ns.get(other, 0) for other in others), default=0)
        is_overtaken = bool(others) and heard - watch.others >= STEPS * len(others)
        is_silent = silent_ns >= LONGEST_NS << times_given_up or (
            is_overtaken and silent_ns >= max(SHORTEST_NS, TIMES_THE_OTHERS * took_ns)
        )
        self.times_given_up[job_id] = times_given_up + is_silent
        return is_silent
