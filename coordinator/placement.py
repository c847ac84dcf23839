"""Live workers, their jobs, and the orders to them."""

from collections.abc import Callable, Iterable, Mapping, Sequence

from msgspec import field

from coordinator.jobs import HAND_OVER_NS, Jobs, Move, balanced
from coordinator.order_delivery import OrderDelivery
from coordinator.part import Part
from coordinator.slow_workers import SilentShards, StragglerPolicy, origin
from particle_filter.settings import FilterSettings
from protocol.work import Assignment, Report, SearchReport, TrackJob, WorkOrder


class Placement(Part):
    """Spreads jobs over live workers, and takes them from those that are gone or too slow."""

    delivery: OrderDelivery
    jobs: Jobs = field(default_factory=Jobs)
    stragglers: StragglerPolicy = field(default_factory=StragglerPolicy)
    silent_shards: SilentShards = field(default_factory=SilentShards)

    @classmethod
    def of(cls, sender: str, settings: FilterSettings, snapshot_every_steps: int) -> "Placement":
        """Return a placement without workers and jobs."""
        return cls(OrderDelivery(sender, settings, snapshot_every_steps))

    @property
    def workers(self) -> dict[str, tuple[str, ...]]:
        """Live workers and their jobs."""
        jobs = self.jobs.by_worker()
        return {name: tuple(jobs.get(name, ())) for name in self.delivery.workers}

    # --- workers

    def joined(self, worker: str, silent_until_ns: int = 0) -> None:
        """Add a worker that appeared; a known worker was restarted and has lost its jobs."""
        if worker in self.delivery:
            self.left(worker)
        self.jobs.came(worker)
        self.delivery.joined(worker, silent_until_ns)

    def left(self, worker: str) -> None:
        """Remove a worker that is gone; others continue its jobs from the last snapshots."""
        self.delivery.left(worker)
        self.stragglers.forget(worker)
        self.jobs.take_from(worker)

    def held(self, worker: str, holds: Iterable[Assignment], now_ns: int) -> None:
        """Store a worker's list of jobs, with snapshots from which another worker can continue."""
        self.delivery.held(worker, self.jobs.held(worker, holds, now_ns))

    def resize(self, sizes: Mapping[str, tuple[int, int]]) -> None:
        """Order other numbers of particles: by job id, how many and from which step on."""
        for job_id, (particles, first_step) in sizes.items():
            worker = self.jobs.resize(job_id, particles, first_step)
            if worker is not None and worker in self.delivery:
                self.delivery.repeat(worker)

    # --- steps

    def waited_for(self, job_ids: Iterable[str]) -> list[str]:
        """Return the jobs whose reports a step waits for; for a silent worker only once."""
        return list(filter(self.waits_for, job_ids))

    def waits_for(self, job_id: str) -> bool:
        job = self.jobs.get(job_id)
        return job is None or job.worker is None or self.stragglers.waits_for(job.worker)

    def reported(self, report: Report, *, in_time: bool) -> None:
        self.jobs.reported(report, in_time=in_time)
        job = self.jobs.get(report.job_id)
        if job is not None and job.worker is not None:
            self.stragglers.heard(job.worker, in_time=in_time)
        if isinstance(report, SearchReport):
            self.silent_shards.reported(report.job_id, report.step)

    def step_decided(
        self,
        expected: Iterable[str],
        missing: Iterable[str],
        now_ns: int,
        *,
        patient: bool = False,
    ) -> None:
        """Process a decided step: workers that are late again lose their jobs.

        Workers with a search are spared: its steps may take longer than a deadline. While all
        workers are slow, moving jobs does not help, so they are given more time.
        """
        owed = {job_id: job for job_id in expected if (job := self.jobs.get(job_id)) is not None}
        late = {
            job.worker
            for job_id in missing
            if (job := owed.pop(job_id, None))
            and job.worker
            and now_ns >= job.placed_ns + HAND_OVER_NS
        }
        reported = {job.worker for job in owed.values() if job.worker}
        blamed = late - self.jobs.searching()
        for worker in self.stragglers.step_decided(reported, blamed, now_ns, patient=patient):
            self.jobs.take_from(worker)

    # --- orders

    def orders(
        self, *, term: int, map_digest: str, now_ns: int, newest_step: int = -1
    ) -> list[tuple[str, WorkOrder]]:
        """Place jobs without a worker, even out, and return the orders that are due."""
        self.jobs.miss_no_longer(now_ns)
        self._give_up_silent_shards(newest_step, now_ns)
        ready = self.delivery.ready(now_ns)
        able = [name for name in ready if self._may_work(name, now_ns)] or ready
        trusted = self.stragglers.trusted(able) or able
        moves = balanced(self.jobs.by_worker(), trusted, self.jobs.may_move)
        self.jobs.carry_out(moves, term, now_ns)
        self.jobs.carry_out(self._trials(able, trusted), term, now_ns)
        jobs = self.jobs.by_worker()
        return self.delivery.orders(
            ready,
            jobs,
            self.jobs.assignment,
            term=term,
            map_digest=map_digest,
            now_ns=now_ns,
        )

    def _give_up_silent_shards(self, newest_step: int, now_ns: int) -> None:
        shards = self.jobs.shards()
        for job_id in self.silent_shards.given_up(shards, newest_step, now_ns):
            worker, shards[job_id].worker = shards[job_id].worker, None
            if worker is not None and self.stragglers.give_up(worker, now_ns):
                self.jobs.take_from(worker)  # with its other shards

    def _trials(self, able: Sequence[str], trusted: Sequence[str]) -> list[Move]:
        """Give one job to one worker of each origin that has never reported."""
        others = {origin(name): name for name in reversed(able) if name not in trusted}
        if not others:
            return []
        jobs = self.jobs.by_worker()
        tried = {origin(name) for name in jobs if name and not self.stragglers.is_proven(name)}
        waiting = [name for one, name in sorted(others.items()) if one not in tried]
        most = max(trusted, key=lambda name: len(jobs.get(name, ())))
        spare = sorted(filter(self.jobs.may_be_tried, jobs.get(most, ())))[1:]
        return [Move(job_id, name) for job_id, name in zip(spare, waiting, strict=False)]

    def _may_work(self, worker: str, now_ns: int) -> bool:
        answers = self.delivery.has_answered(worker)
        return self.stragglers.may_work(worker, now_ns, answers=answers)

    # --- from one coordinator to the next

    def jobs_to_hand_on(self) -> Jobs:
        """Return all jobs, without particles that a worker holds."""
        return self.jobs.without_held(
            lambda job_id, job: isinstance(job.job, TrackJob) and self.delivery.is_held(job_id, job)
        )

    def resume(
        self, jobs: Jobs, rebuilt: Callable[[str], TrackJob], now_ns: int, term: int
    ) -> None:
        """Continue with another coordinator's jobs; see `Jobs.resume`."""
        self.jobs.resume(jobs, rebuilt, self.delivery, now_ns, term=term)
        self.delivery.forget()
