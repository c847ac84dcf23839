"""Which shards of a search are given up: their workers do not report while others do.

A step of a search may take long, and how long depends on the map. So a shard is measured by the
others: it may take some times as long as they did. One that all wait for is given up by time.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from coordinator.membership.jobs import PlacedJob
from protocol.work import SearchJob

STEPS = 5
"""So many steps of each other shard without a word of this one."""
SHORTEST_NS = 3_000_000_000
"""And at least for so long."""
TIMES_THE_OTHERS = 3
"""And for so many times as long as the slowest other one took for its first step."""
LONGEST_NS = 30_000_000_000
"""For so long whatever the others do; doubled each time, for the map may be a large one."""
PAUSE_NS = 1_000_000_000
"""This process has not looked for longer: nobody could report."""


@dataclass
class _Watch:
    """One shard at its present worker, since its last report."""

    epoch: int
    reports: int
    others: int
    """Reports of other workers' shards until then."""
    since_ns: int


class SilentShards:
    """Told of search reports; says which shards another worker should have."""

    def __init__(self) -> None:
        self._reports: Counter[str] = Counter()
        self._steps: dict[str, int] = {}
        self._took_ns: dict[str, int] = {}
        """For the first step, of those that have reported one."""
        self._given_up: Counter[str] = Counter()
        self._watches: dict[str, _Watch] = {}
        self._looked_ns = 0

    def reported(self, job_id: str, step: int) -> None:
        """A shard's worker has reported a step."""
        self._reports[job_id] += 1
        self._steps[job_id] = max(step, self._steps.get(job_id, step))

    def given_up(self, shards: Mapping[str, PlacedJob], newest_step: int, now_ns: int) -> list[str]:
        """Shards that have been silent for too long.

        Args:
            shards: jobs of the search that runs.
            newest_step: the newest whose scan has come; a robot that stands makes none.
            now_ns: by the clock of all events.
        """
        if now_ns - self._looked_ns > PAUSE_NS:
            self._watches.clear()
        self._looked_ns = now_ns
        for known in (self._reports, self._steps, self._took_ns, self._given_up, self._watches):
            for job_id in known.keys() - shards.keys():
                del known[job_id]
        return [job_id for job_id in shards if self._is_silent(job_id, shards, newest_step, now_ns)]

    def _is_silent(
        self, job_id: str, shards: Mapping[str, PlacedJob], newest_step: int, now_ns: int
    ) -> bool:
        placed, reports = shards[job_id], self._reports[job_id]
        others = [other for other, job in shards.items() if job.worker != placed.worker]
        heard = sum(self._reports[other] for other in others)
        watch = self._watches.get(job_id)
        first = placed.job.first_step if isinstance(placed.job, SearchJob) else 0
        owes = newest_step >= max(first, self._steps.get(job_id, first - 1) + 1)
        if (
            watch is None
            or (watch.epoch, watch.reports) != (placed.epoch, reports)
            or not owes
            or placed.worker is None
        ):
            if watch is not None and watch.epoch == placed.epoch and reports:
                self._took_ns.setdefault(job_id, now_ns - watch.since_ns)
            self._watches[job_id] = _Watch(placed.epoch, reports, heard, now_ns)
            return False
        silent_ns = now_ns - watch.since_ns
        took_ns = max((self._took_ns.get(other, 0) for other in others), default=0)
        is_overtaken = bool(others) and heard - watch.others >= STEPS * len(others)
        is_silent = silent_ns >= LONGEST_NS << self._given_up[job_id] or (
            is_overtaken and silent_ns >= max(SHORTEST_NS, TIMES_THE_OTHERS * took_ns)
        )
        self._given_up[job_id] += is_silent
        return is_silent
