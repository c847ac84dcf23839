"""The orders that each worker has been sent, and the jobs that it has confirmed.

An order names all jobs of a worker, so the newest one replaces all lost ones. It is sent when it
differs from the last one, and repeated until the worker has answered it.
"""

from collections.abc import Callable, Iterable, Mapping

import msgspec

from coordinator.jobs import PlacedJob
from coordinator.part import Part
from particle_filter.settings import FilterSettings
from protocol.work import Assignment, OrderAnswer, TrackJob, WorkOrder

RESEND_AFTER_NS = 500_000_000


class LiveWorker(Part):
    """A worker whose token is there, and the orders that it was sent."""

    order: int = 0
    sent_ns: int = -RESEND_AFTER_NS
    told: dict[str, int] | None = None
    """Jobs and epochs of the last order; None: send an order in any case."""
    known: dict[str, int] = {}
    """Jobs and epochs that the worker has confirmed."""
    answered: bool = True
    silent_until_ns: int = 0
    """Before this time it gets no order, because it is asked for its state first [ns]."""


class OrderDelivery(Part):
    """Decides which orders to live workers are due."""

    sender: str
    settings: FilterSettings
    snapshot_every_steps: int
    records: dict[str, LiveWorker] = {}
    orders_sent: int = 0

    @property
    def workers(self) -> list[str]:
        """Live workers, by name."""
        return sorted(self.records)

    def __contains__(self, worker: object) -> bool:
        return worker in self.records

    def ready(self, now_ns: int) -> list[str]:
        """Workers that may get orders now, by name."""
        return [
            name
            for name, record in sorted(self.records.items())
            if record.silent_until_ns <= now_ns
        ]

    def joined(self, worker: str, silent_until_ns: int) -> None:
        """Add a worker without jobs, which gets no orders for a while."""
        self.records[worker] = LiveWorker(silent_until_ns=silent_until_ns)

    def left(self, worker: str) -> None:
        self.records.pop(worker, None)

    def repeat(self, worker: str) -> None:
        """Send a worker its order again, after a lost link or the change of a job."""
        self.records[worker].told = None

    def held(self, worker: str, jobs: Iterable[Assignment]) -> None:
        """Take the jobs that a worker reports; it may get orders from now on."""
        record = self.records[worker]
        record.told, record.silent_until_ns = None, 0
        record.known |= {held.job_id: held.epoch for held in jobs}

    def forget(self) -> None:
        """Forget what was sent and confirmed: another coordinator's jobs replace this one's."""
        for record in self.records.values():
            record.told, record.known = None, {}

    def answered(self, worker: str, answer: OrderAnswer) -> None:
        """Take a worker's answer to an order.

        A worker that was restarted unnoticed answers without the jobs that it should keep.
        """
        record = self.records.get(worker)
        if record is None:
            return
        record.known = {job_id: epoch for job_id, epoch, _ in answer.jobs}
        taken = answer.order == record.order and not answer.problem
        kept = record.told is None or record.told.items() <= record.known.items()
        record.answered = taken and kept

    def has_answered(self, worker: str) -> bool:
        """Return whether a live worker has accepted its last order."""
        return self.records[worker].answered

    def is_held(self, job_id: str, job: PlacedJob) -> bool:
        """Return whether the worker of a job has confirmed it."""
        record = self.records.get(job.worker) if job.worker is not None else None
        return record is not None and record.known.get(job_id) == job.epoch

    def orders(
        self,
        workers: Iterable[str],
        jobs: Mapping[str | None, dict[str, int]],
        assignment: Callable[[str], Assignment],
        *,
        term: int,
        map_digest: str,
        now_ns: int,
    ) -> list[tuple[str, WorkOrder]]:
        """Return the orders that are due.

        Args:
            workers: workers that may get orders now; see `ready`.
            jobs: epochs of the jobs of each worker, by job id.
            assignment: returns the assignment of a job.
            term: term of this coordinator.
            map_digest: digest of the map in which the robot is localized.
            now_ns: time by the clock of all events [ns].
        """
        due = []
        for name in workers:
            record, own = self.records[name], jobs.get(name, {})
            unanswered = not record.answered and now_ns - record.sent_ns >= RESEND_AFTER_NS
            if record.told == own and not unanswered:
                continue
            self.orders_sent += 1
            record.order, record.sent_ns = self.orders_sent, now_ns
            record.told, record.answered = own, False
            keep = tuple(sorted(own.items() & record.known.items()))
            begin = sorted(own.items() - record.known.items())
            kept = ((job_id, assignment(job_id).job) for job_id, _ in keep)
            order = WorkOrder(
                sender=self.sender,
                order=record.order,
                term=term,
                map_digest=map_digest,
                filter_settings=msgspec.to_builtins(self.settings),
                snapshot_every_steps=self.snapshot_every_steps,
                keep=keep,
                begin=tuple(assignment(job_id) for job_id, _ in begin),
                resize=tuple(
                    (job_id, job.particles, job.particles_from)
                    for job_id, job in kept
                    if isinstance(job, TrackJob) and job.particles and job.particles_from >= 0
                ),
            )
            due.append((name, order))
        return due
