"""What must hold whatever the network does; a broken law ends the schedule.

Each is checked against what the simulation itself has seen, not against what the product says.
"""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from clustermcl.coordinator import events
from clustermcl.coordinator.checkpoint import state_in
from clustermcl.coordinator.coordinator import Coordinator, Started
from clustermcl.coordinator.instructions import Instruction, SendOrder
from clustermcl.coordinator.state import CoordinatorState
from clustermcl.coordinator.step_collector import ReadyStep
from clustermcl.protocol.answers import Belief, PoseAnswer
from clustermcl.protocol.work import Checkpoint, TrackReport, WorkOrder
from tests.simulation.network import SECOND, Clock

SUM_TOLERANCE = 1e-9
TOLERANCE_S = 0.001
NOTHING = (False, 0, 0)


class LawBrokenError(AssertionError):
    """Something happened that never must."""


def demand(holds: object, law: str) -> None:
    if not holds:
        raise LawBrokenError(law)


@dataclass
class Decided:
    """A step that a coordinator, or one before it, has applied."""

    step: int
    stamp_ns: int


@dataclass(eq=False)
class Life:
    laws: "Laws"
    name: str
    started: Started
    decided: list[Decided] = field(default_factory=list)
    """Also what those before it decided, from which it carries on."""
    by_serial: dict[int, int] = field(default_factory=dict)
    """How many decisions a checkpoint holds."""
    known_terms: list[int] = field(default_factory=list)
    """Of each worker that answered before it began: that of the last belief it had in its hands."""
    begun_from: tuple[bool, int, int] | None = None
    carried_on: list["Life"] = field(default_factory=list)
    """Those before it, from which it carries on."""
    unknown_s: dict[int, float] = field(default_factory=dict)
    """By stamp: the part of a datum's age at its arrival that no process can know. For a live
    robot, odometry that arrives later than usual shows its delay."""
    promptest_s: float = math.inf
    newest_odometry_ns: int = -1
    is_live: bool = False

    def watch(self, coordinator: Coordinator) -> None:
        """See which checkpoint it continues from, and what it counts."""
        state = coordinator.state
        watched = WatchedState(**{name: getattr(state, name) for name in state.__struct_fields__})
        watched.life = self
        coordinator.state = watched

    def carries_on(self, checkpoint: Checkpoint) -> None:
        before = self.laws.published.get((checkpoint.term, checkpoint.serial))
        demand(before is not None, "what is carried on from was published")
        assert before is not None
        life, state = before
        demand(state == checkpoint.state, "a checkpoint is as it was published")
        self.begun_from = checkpoint.rank
        self.carried_on = [*life.carried_on, life]
        self.decided = life.decided[: life.by_serial[checkpoint.serial]]

    @property
    def must_know(self) -> tuple[bool, int, int]:
        """The best checkpoint that it had in its hands, and that was of this life of the system."""
        known, kept = self.started.known, self.started.kept
        ranks = [known.rank] if known else []
        newest = max(self.known_terms, default=0)
        if kept and newest and (kept.term == newest or self.laws.ruled(newest) == self.name):
            ranks.append(kept.rank)
        return max(ranks, default=NOTHING)

    def decisions_until(self, step: int) -> int:
        """How many there are with that of a step."""
        counts = (n for n, one in enumerate(self.decided, 1) if one.step == step)
        return max(counts, default=0)

    def decides(self, ready: ReadyStep) -> None:
        tracks = [report for report in ready.reports if isinstance(report, TrackReport)]
        ids = [report.job_id for report in tracks]
        demand(len(set(ids)) == len(ids), "no report counts twice in a step")
        demand(all(report.step == ready.scan.step for report in tracks), "a report is of its step")
        for report in ready.reports:
            _, giver = self.laws.given[report.job_id, report.epoch]
            demand(giver in (self, *self.carried_on), "what counts is of a job of its own history")
        newest = self.decided[-1].stamp_ns if self.decided else None
        later = newest is None or ready.scan.stamp_ns > newest
        demand(later or self.laws.restarts_count, "no scan counts twice, for any coordinator")
        self.decided.append(Decided(ready.scan.step, ready.scan.stamp_ns))

    def handled(self, event: events.Event) -> None:
        match event:
            case events.OdometryArrived(reading) if reading.stamp_ns != self.newest_odometry_ns:
                self.newest_odometry_ns = reading.stamp_ns  # the same again is no news
                late_s = self.laws.age_s(reading.stamp_ns)
                if self.is_live:
                    late_s = self.promptest_s = min(self.promptest_s, late_s)
                self.unknown_s.setdefault(reading.stamp_ns, late_s)
            case events.ScanArrived(scan):
                self.is_live |= scan.live
                self.unknown_s.setdefault(scan.stamp_ns, self.laws.age_s(scan.stamp_ns))
            case events.HistoryArrived(scans):
                for scan in scans:
                    self.unknown_s.setdefault(scan.stamp_ns, self.laws.age_s(scan.stamp_ns))


class WatchedState(CoordinatorState, dict=True):
    if TYPE_CHECKING:
        life: Life  # not a field of the state: it is not encoded

    def resume(self, checkpoint: Checkpoint, now_ns: int) -> int | None:
        step = super().resume(checkpoint, now_ns)
        if step is not None:
            self.life.carries_on(checkpoint)
        return step

    def apply(self, ready: ReadyStep, now_ns: int) -> None:
        self.life.decides(ready)
        super().apply(ready, now_ns)


class Laws:
    def __init__(self, clock: Clock, *, live: bool) -> None:
        self.clock, self.live = clock, live
        self.published: dict[tuple[int, int], tuple[Life, bytes]] = {}
        """By term and serial."""
        self.lives: list[Life] = []
        self.restarts_count = False
        """The bridge has died while no process could give it the step: it repeats numbers, and no
        belief survives that."""
        self.taken_ns: dict[int, int] = {}
        """When a scan or an odometry pose was taken, by its stamp."""
        self._rules: dict[int, Life] = {}
        self.given: dict[tuple[str, int], tuple[str, Life]] = {}
        """By job and epoch: to which worker, and by whom first."""
        self.steps = 0

    def life(self, name: str, started: Started, coordinator: Coordinator) -> Life:
        """A coordinator begins to recover."""
        life = Life(self, name, started)
        life.watch(coordinator)
        self.lives.append(life)
        return life

    def carried_out(self, life: Life | None, instruction: Instruction) -> None:
        assert life is not None
        match instruction:
            case Checkpoint():
                self._published(life, instruction)
            case SendOrder(worker, order):
                self._ordered(life, worker, order)

    def _published(self, life: Life, checkpoint: Checkpoint) -> None:
        self._rules_alone(life, checkpoint.term)
        if checkpoint.serial == 0 and not life.by_serial:
            known = life.must_know if life.must_know[0] and not self.restarts_count else NOTHING
            demand(
                (life.begun_from or NOTHING) >= known, "nothing that a process knows is forgotten"
            )
        demand(_is_of_use(checkpoint), "what is published can be carried on from")
        key = (checkpoint.term, checkpoint.serial)
        life.by_serial.setdefault(checkpoint.serial, life.decisions_until(checkpoint.step))
        _, state = self.published.setdefault(key, (life, checkpoint.state))
        demand(state == checkpoint.state, "a checkpoint has one meaning")

    def _ordered(self, life: Life, worker: str, order: WorkOrder) -> None:
        self._rules_alone(life, order.term)
        for given in order.begin:
            holder, _ = self.given.setdefault((given.job_id, given.epoch), (worker, life))
            demand(holder == worker, "a job has one worker in an epoch, whoever gives it")

    def ruled(self, term: int) -> str:
        return self._rules[term].name

    def _rules_alone(self, life: Life, term: int) -> None:
        demand(self._rules.setdefault(term, life) is life, "one coordinator rules in a term")

    def believed(self, belief: Belief) -> None:
        self.steps += 1
        probabilities = [hypothesis.probability for hypothesis in belief.hypotheses]
        probabilities.append(belief.elsewhere_probability)
        demand(all(0.0 <= p <= 1.0 for p in probabilities), "probabilities are from 0 to 1")
        total = math.fsum(probabilities)
        demand(abs(total - 1.0) <= SUM_TOLERANCE, f"probabilities sum to one, not to {total}")

    def on_pose(self, life: Life, pose: PoseAnswer) -> None:
        """An observer has queried the pose.

        Clocks may be apart by anything, so it counts from when the data should have arrived. A
        recording's stamps show no delay: after a take-over, its data count as older than they are.
        """
        if pose.freshness in ("none", "stale"):
            return
        age_s = self.age_s(pose.stamp_ns)
        demand(
            age_s - life.unknown_s.get(pose.stamp_ns, life.promptest_s) - TOLERANCE_S
            <= pose.age_s
            <= (age_s + TOLERANCE_S if self.live else math.inf),
            f"the pose's age is true: {pose.age_s:.3f} s reported, {age_s:.3f} s in truth",
        )

    def age_s(self, stamp_ns: int) -> float:
        """How long ago a scan or an odometry pose was taken."""
        return (self.clock.now_ns - self.taken_ns[stamp_ns]) / SECOND


def _is_of_use(checkpoint: Checkpoint) -> bool:
    try:
        state_in(checkpoint)
    except ValueError:
        return False
    return True
