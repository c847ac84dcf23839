"""Live workers, their jobs, and the orders to them.

An order names all jobs of a worker, so the newest one replaces all lost ones. It is sent when it
differs from the last one, and repeated until the worker has answered it.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

import msgspec
from msgspec import field
from msgspec.structs import replace

from clustermcl.belief.part import Part
from clustermcl.coordinator.jobs import AWAITED_NS, HAND_OVER_NS, Jobs, PlacedJob, balanced
from clustermcl.coordinator.slow_workers import SilentShards, StragglerPolicy, origin
from clustermcl.filter.settings import FilterSettings
from clustermcl.protocol import work

RESEND_AFTER_NS = 500_000_000


class LiveWorker(Part):
    """A worker whose token is present, and the last order to it."""

    order: int = 0
    sent_ns: int = -RESEND_AFTER_NS
    ordered: dict[str, int] | None = None
    """Jobs and epochs of the order; None: another order is due in any case."""
    confirmed: dict[str, int] = {}
    answered: bool = True
    reports_lost: bool = True
    """Whether the next order has it repeat its reports on steps that are not applied."""
    silent_until_ns: int = 0
    """The worker gets no order before this time, because it is first asked for its state [ns]."""


class Placement(Part):
    """Spreads jobs over live workers, and takes them from workers that are gone or too slow."""

    sender: str
    settings: FilterSettings
    snapshot_every_steps: int
    live: dict[str, LiveWorker] = {}
    orders_sent: int = 0
    jobs: Jobs = field(default_factory=Jobs)
    stragglers: StragglerPolicy = field(default_factory=StragglerPolicy)
    silent_shards: SilentShards = field(default_factory=SilentShards)

    @property
    def workers(self) -> dict[str, tuple[str, ...]]:
        jobs = self.jobs.by_worker()
        return {name: tuple(jobs.get(name, ())) for name in sorted(self.live)}

    # --- workers

    def on_worker_joined(self, worker: str, silent_until_ns: int = 0) -> None:
        """Add a worker; a known worker was restarted and has lost its jobs."""
        if worker in self.live:
            self.on_worker_left(worker)
        self.jobs.awaited_until_ns.pop(worker, None)
        self.live[worker] = LiveWorker(silent_until_ns=silent_until_ns)

    def on_worker_left(self, worker: str) -> None:
        self.live.pop(worker, None)
        self.stragglers.forget(worker)
        self.jobs.take_from(worker)

    def on_worker_jobs(self, worker: str, holds: Iterable[work.Assignment], now_ns: int) -> None:
        """Store the jobs that a worker holds, with their snapshots; it may get orders now."""
        confirmed = {job.job_id: job.epoch for job in self.jobs.held(worker, holds, now_ns)}
        live = self.live[worker]
        live.ordered, live.silent_until_ns = None, 0
        live.confirmed |= confirmed

    def on_order_answer(self, worker: str, answer: work.OrderAnswer) -> None:
        """Store which jobs a worker has; one that was restarted unnoticed gets the order again."""
        if (live := self.live.get(worker)) is None:
            return
        live.confirmed = {job_id: epoch for job_id, epoch, _ in answer.jobs}
        accepted = answer.order == live.order and not answer.problem
        kept = live.ordered is None or live.ordered.items() <= live.confirmed.items()
        live.answered = accepted and kept
        live.reports_lost &= not live.answered or live.ordered is None

    def repeat_order(self, worker: str) -> None:
        """Send a worker its order again, after a lost link; it then repeats its reports."""
        live = self.live[worker]
        live.ordered, live.reports_lost = None, True

    def on_link_back(self) -> None:
        self.silent_shards.forgive()
        for worker in self.live:
            self.repeat_order(worker)

    def resize(self, sizes: Mapping[str, tuple[int, int]]) -> None:
        """Change numbers of particles; `sizes`: the number and its first step, by job id."""
        for job_id, (particles, first_step) in sizes.items():
            placed = self.jobs.placed[job_id]
            assert isinstance(placed.job, work.TrackJob)  # only clusters have particles
            placed.job = replace(placed.job, particles=particles, particles_from=first_step)
            if (live := self.live.get(placed.worker or "")) is not None:
                live.ordered = None

    # --- steps

    def waits_for(self, job_id: str) -> bool:
        """Return whether a step waits for a job's report; a silent worker delays only one step."""
        job = self.jobs.placed.get(job_id)
        return job is None or job.worker is None or self.stragglers.waits_for(job.worker)

    def on_report(self, report: work.Report, *, in_time: bool) -> None:
        self.jobs.on_report(report, in_time=in_time)
        job = self.jobs.placed[report.job_id]
        if job.worker is not None:
            self.stragglers.on_report(job.worker)
        if isinstance(report, work.SearchReport):
            self.silent_shards.on_report(report.job_id, report.step)

    def on_step_decided(
        self, expected: Iterable[str], missing: Iterable[str], now_ns: int, *, patient: bool = False
    ) -> None:
        """Take the jobs of workers that were late too often; `patient`: all workers are slow.

        Workers with a search keep their jobs: its steps may take longer than a deadline.
        """
        placed, shards = self.jobs.placed, self.jobs.shards()
        owed = {i: placed[i] for i in expected if i in placed and i not in shards}
        missed = [job for job_id in missing if (job := owed.pop(job_id, None))]
        late = {j.worker for j in missed if j.worker and now_ns >= j.placed_ns + HAND_OVER_NS}
        reported = {job.worker for job in owed.values() if job.worker}
        keep = {job.worker for job in shards.values()}
        policy = self.stragglers
        for worker in policy.on_step_decided(reported, late, now_ns, patient=patient, keep=keep):
            self.jobs.take_from(worker)

    # --- orders

    def orders(
        self,
        *,
        term: int,
        map_digest: str,
        now_ns: int,
        newest_step: int = -1,
        applied_step: int = -1,
    ) -> list[tuple[str, work.WorkOrder]]:
        """Give waiting jobs to workers, balance the load, and return each worker's due order."""
        self.jobs.give_up_awaited(now_ns)
        self._give_up_silent_shards(newest_step, now_ns)
        ready = [name for name, live in sorted(self.live.items()) if live.silent_until_ns <= now_ns]
        may_work, live = self.stragglers.may_work, self.live
        able = [name for name in ready if may_work(name, now_ns, answers=live[name].answered)]
        able = able or ready
        trusted = self.stragglers.trusted(able) or able
        awake = [worker for worker in trusted if self.stragglers.waits_for(worker)]
        self.jobs.move(self._moves(awake or trusted), term, now_ns)
        # A step waits for a trial until its deadline, without the time for handing a job over.
        self.jobs.move(self._trials(able, trusted), term, now_ns=0)
        jobs, due = self.jobs.by_worker(), list[tuple[str, work.WorkOrder]]()
        make = partial(self._order, term=term, map_digest=map_digest, now_ns=now_ns)
        for name in ready:
            worker, wanted = live[name], jobs.get(name, {})
            is_resend_due = not worker.answered and now_ns - worker.sent_ns >= RESEND_AFTER_NS
            if worker.ordered != wanted or is_resend_due:
                due.append((name, make(worker, wanted, applied_step)))
        return due

    def _moves(self, trusted: Sequence[str]) -> dict[str, str]:
        """Return the new worker of each job that changes hands.

        One worker does all jobs of a lone cluster: to wake a second one costs more than the
        other job, that of elsewhere.
        """
        placed = self.jobs.placed
        clusters = [one for one in placed.values() if isinstance(one.job, work.TrackJob)]
        others = [one for one in placed.values() if isinstance(one.job, work.ElsewhereJob)]
        if len(clusters) != 1 or len(others) + 1 != len(placed) or not trusted:
            return balanced(self.jobs.by_worker(), trusted, self.jobs.may_move)
        at_work = [one.worker for one in (*clusters, *others) if one.worker in trusted]
        home = next(iter(at_work), None) or min(trusted)
        return {
            job_id: home
            for job_id, one in placed.items()
            if one.worker is None or (one.worker != home and one.worker in trusted)
        }

    def _order(
        self,
        worker: LiveWorker,
        jobs: dict[str, int],
        applied_step: int,
        *,
        term: int,
        map_digest: str,
        now_ns: int,
    ) -> work.WorkOrder:
        self.orders_sent += 1
        worker.order, worker.sent_ns = self.orders_sent, now_ns
        worker.ordered, worker.answered = jobs, False
        keep = tuple(sorted(jobs.items() & worker.confirmed.items()))
        begin = sorted(jobs.items() - worker.confirmed.items())
        kept = ((job_id, self.jobs.placed[job_id].job) for job_id, _ in keep)
        return work.WorkOrder(
            sender=self.sender,
            order=worker.order,
            term=term,
            map_digest=map_digest,
            filter_settings=msgspec.to_builtins(self.settings),
            snapshot_every_steps=self.snapshot_every_steps,
            keep=keep,
            begin=tuple(self.jobs.assignment(job_id) for job_id, _ in begin),
            resize=tuple(
                (job_id, job.particles, job.particles_from)
                for job_id, job in kept
                if isinstance(job, work.TrackJob) and job.particles and job.particles_from >= 0
            ),
            repeat_after=applied_step if worker.reports_lost else None,
        )

    def _give_up_silent_shards(self, newest_step: int, now_ns: int) -> None:
        shards = self.jobs.shards()
        for job_id in self.silent_shards.given_up(shards, newest_step, now_ns):
            worker, shards[job_id].worker = shards[job_id].worker, None
            if worker is not None and self.stragglers.give_up(worker, now_ns):
                self.jobs.take_from(worker)  # with its other shards

    def _trials(self, able: Sequence[str], trusted: Sequence[str]) -> dict[str, str]:
        """Return a trial job, by id, for one worker of each origin that has never reported."""
        others = {origin(name): name for name in reversed(able) if name not in trusted}
        if not others:
            return {}
        jobs = self.jobs.by_worker()
        tried = {origin(name) for name in jobs if name and name not in self.stragglers.proven}
        waiting = [name for one, name in sorted(others.items()) if one not in tried]
        most = max(trusted, key=lambda name: len(jobs.get(name, ())))
        tracks = jobs.get(most, {}).keys() - self.jobs.shards().keys()
        spare = sorted(filter(self.jobs.may_move, tracks))[1:]
        return dict(zip(spare, waiting, strict=False))

    # --- from one coordinator to the next

    def jobs_to_hand_on(self) -> Jobs:
        """Return all jobs, without particles that a worker holds."""

        def handed_on(job_id: str, job: PlacedJob) -> PlacedJob:
            worker = self.live.get(job.worker or "")
            is_held = worker is not None and worker.confirmed.get(job_id) == job.epoch
            return replace(job, job=None) if is_held and isinstance(job.job, work.TrackJob) else job

        return Jobs({job_id: handed_on(job_id, job) for job_id, job in self.jobs.placed.items()})

    def resume(
        self, jobs: Jobs, rebuilt: Callable[[str], work.TrackJob], now_ns: int, term: int
    ) -> None:
        """Continue with the jobs of another coordinator, of this term, in place of the own.

        Workers that are not present keep theirs for a while. `rebuilt` makes the job of a cluster
        whose particles only its worker holds.
        """
        self.jobs.placed = {
            job_id: PlacedJob(
                job.job or rebuilt(job_id),
                job.epoch,
                job.worker,
                now_ns,
                reported=True,
                term=term,
                is_handed_on=True,
            )
            for job_id, job in jobs.placed.items()
        }
        holders = {job.worker for job in jobs.placed.values() if job.worker} - self.live.keys()
        self.jobs.awaited_until_ns = dict.fromkeys(sorted(holders), now_ns + AWAITED_NS)
        for worker in self.live.values():
            worker.ordered, worker.confirmed, worker.reports_lost = None, {}, True
