"""Who keeps a copy of a cluster's particles, for when its worker and the coordinator die together.

The coordinator itself has every cluster's last particles, and gives them to a second worker when
the cluster begins and now and then later. Whoever carries on from a copy takes the scans since from
the bridge's history, so its particles are those that the dead worker would have had.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from coordinator.membership.jobs import PlacedJob
from protocol.work import Assignment, TrackJob

NEW_COPY_EVERY_STEPS = 50
"""Well within the bridge's history; the scans since are what a cluster has to catch up with."""


@dataclass(frozen=True)
class _Copy:
    keeper: str
    job: TrackJob
    epoch: int


class SecondKeepers:
    """Decides which worker keeps a copy of which cluster, and from which step."""

    def __init__(self) -> None:
        self._copies: dict[str, _Copy] = {}

    def keeper(self, job_id: str) -> str | None:
        """The worker that is to have a copy of a cluster; None: nobody is."""
        copy = self._copies.get(job_id)
        return copy.keeper if copy else None

    def copies(
        self, tracked: Mapping[str, PlacedJob], workers: Sequence[str]
    ) -> dict[str, list[Assignment]]:
        """What each worker is to keep; one that has a copy goes on to have it.

        Args:
            tracked: clusters that have a worker.
            workers: that may get orders.
        """
        copies = {
            job_id: copy
            for job_id, copy in self._copies.items()
            if job_id in tracked
            and copy.keeper in workers
            and copy.keeper != tracked[job_id].worker
        }
        load = Counter(copy.keeper for copy in copies.values())
        for job_id, placed in tracked.items():
            before = copies.get(job_id)
            if before is not None and not _is_old(before.job, placed.job):
                continue
            others = [worker for worker in workers if worker != placed.worker]
            if others and isinstance(placed.job, TrackJob):
                keeper = before.keeper if before else min(others, key=lambda w: (load[w], w))
                load[keeper] += before is None
                copies[job_id] = _Copy(keeper, placed.job, placed.epoch)
        self._copies = copies
        kept: dict[str, list[Assignment]] = {}
        for job_id, copy in sorted(copies.items()):
            assignment = Assignment(job_id=job_id, epoch=copy.epoch, job=copy.job)
            kept.setdefault(copy.keeper, []).append(assignment)
        return kept


def _is_old(copied: TrackJob, now: object) -> bool:
    """Whether a copy has to be made anew; one that is ahead is of another count of steps."""
    if not isinstance(now, TrackJob):
        return False
    return not 0 <= now.start.step - copied.start.step < NEW_COPY_EVERY_STEPS
