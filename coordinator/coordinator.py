"""The coordinator's decisions: told what happened, answers what to send.

No network, no clock: events carry `now_ns`, instructions are plain objects. So a whole failure
story is a unit test.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from coordinator.books import Books
from coordinator.checkpoint import OfferState
from coordinator.commands import carry_out
from coordinator.inquiry import Told
from coordinator.instructions import FetchScans, Instruction, PublishBelief, SendOrder
from coordinator.last_pose import LastPose
from coordinator.spokesman import Spokesman
from coordinator.succession import Succession
from particle_filter.settings import FilterSettings
from process_runtime.settings import CoordinatorSettings
from protocol.answers import CommandDone, Hypotheses, PoseAnswer, Relocalize, SetPose, Status
from protocol.numbering import Numbering
from protocol.steps import OdometryReading, Scan
from protocol.work import Checkpoint, OrderAnswer, Report

NEVER_LATER = 16
"""More steps than this lost before the first scan that is heard, and nobody looks for them."""


class Coordinator:
    """All that the coordinator process decides."""

    def __init__(
        self,
        sender: str,
        filter_settings: FilterSettings,
        settings: CoordinatorSettings,
        version: str,
        now_ns: int,
        *,
        term: int = 0,
        known: Checkpoint | None = None,
        last_poses: Mapping[str, LastPose] = MappingProxyType({}),
        live: bool = False,
    ) -> None:
        """Know nothing yet.

        Args:
            sender: name of the process.
            filter_settings: the filter's numbers.
            settings: the coordinator's.
            version: of the software.
            now_ns: by the clock of all events.
            term: see `Succession`; raised above all that workers know.
            known: a checkpoint that was heard before the workers are asked.
            last_poses: where the robot was at the end of an earlier life, by the map's digest.
            live: the robot's stamps are of a clock that runs like any other.
        """
        self._sender, self._settings = sender, settings
        self._last_poses = last_poses
        self._books = Books(sender, filter_settings, settings, live=live)
        self._spokesman = Spokesman(sender, version, self._books, now_ns)
        self._succession = Succession(sender, term, known, now_ns)
        self._numbering = Numbering()
        self._early_reports: list[tuple[Report, str]] = []
        self._linked = True

    @property
    def outranked_by(self) -> int | None:
        """A higher term that somebody knows of: another coordinator acts, this one must not."""
        return self._succession.outranked_by

    @property
    def map_digest(self) -> str:
        """Of the map in which the robot is looked for; empty before the first scan."""
        return self._books.placement.map_digest

    @property
    def begun(self) -> bool:
        """Whether it knows enough to answer."""
        return self._succession.begun

    # --- what the robot does

    def scan(self, scan: Scan, now_ns: int) -> list[Instruction]:
        """A step's scan arrived."""
        books = self._books
        if not books.placement.map_digest:
            books.placement.map_digest = scan.map_digest
        elif scan.map_digest != books.placement.map_digest:
            books.counters["scan of another map"] += 1
            return []
        if not books.collector.take_scan(scan, now_ns):
            books.counters["scan repeated or late"] += 1
            if self.begun and self._numbering.starts_anew(scan, books.applied_scan):
                books.count_anew(scan)
                return self.scan(scan, now_ns)
            return self._say_again(scan, now_ns)
        books.pose.scan(scan.stamp_ns, scan.odom_from_robot, now_ns)
        if not self.begun:
            return self.tick(now_ns)
        self._begin_search(scan)
        lost = books.collector.lost_before(scan)
        return ([FetchScans(*lost)] if lost else []) + self.tick(now_ns)

    def history(self, scans: Sequence[Scan], now_ns: int) -> list[Instruction]:
        """Steps of the past; a coordinator without any begins with the newest of them."""
        if self.begun and not self._books.ensemble.searches:
            self._books.collector.begin_after(scans[-1].step - 1 if scans else -1)
            scans = scans[-1:]
        return [do for scan in scans for do in self.scan(scan, now_ns)]

    def odometry(self, reading: OdometryReading, now_ns: int) -> None:
        """The robot moved."""
        self._books.pose.odometry(reading.stamp_ns, reading.odom_from_robot, now_ns)

    # --- what workers do

    def report(self, report: Report, worker: str, now_ns: int) -> list[Instruction]:
        """A worker's job took a step."""
        if self.begun:
            self._books.take(report, worker)
        else:
            self._early_reports.append((report, worker))
        return self.tick(now_ns)

    def worker_joined(self, name: str, now_ns: int) -> list[Instruction]:
        """A worker's liveliness token appeared."""
        missed = self._books.placement.misses(name)
        silent_until_ns = self._succession.joined(name, now_ns, missed=missed)
        self._books.placement.joined(name, silent_until_ns)
        self._books.changed = True  # a newcomer has heard no checkpoint yet
        return self.tick(now_ns)

    def worker_told(self, name: str, told: Told, now_ns: int) -> list[Instruction]:
        """A worker says what it does, and what the last coordinator had decided."""
        if not self._books.placement.has(name):
            return []
        self._succession.answered(name, told)
        if not self.begun:
            return self.tick(now_ns)
        newest, resumed = told.checkpoint, list[Instruction]()
        if newest is not None and newest.founded and not self._succession.founded:
            resumed = self._resume(newest, now_ns)
        if not resumed:
            self._hear_out(name, told, now_ns)
        return resumed + self.tick(now_ns)

    def worker_left(self, name: str, now_ns: int) -> list[Instruction]:
        """A worker's liveliness token is gone."""
        self._books.placement.left(name)
        self._succession.left(name)
        self._books.changed = True
        return self.tick(now_ns)

    def worker_returned(self, name: str, now_ns: int) -> list[Instruction]:
        """A worker that was away with our link is back; whether it is the same, it will say."""
        self._books.placement.returned(name)
        return self.tick(now_ns)

    def order_answered(self, worker: str, answer: OrderAnswer) -> None:
        """A worker took an order, or says why not."""
        if answer.problem:
            self._books.counters["order refused"] += 1  # the worker's log says why
        self._succession.hear_term(answer.term)
        self._books.placement.answered(worker, answer)

    # --- what others do

    def checkpoint_heard(self, checkpoint: Checkpoint) -> None:
        """Some coordinator, perhaps this one, published its checkpoint."""
        self._succession.hear(checkpoint)

    def link_lost(self) -> None:
        """Our own link is down: nothing is decided until it is back."""
        self._linked = False

    def link_back(self, now_ns: int) -> list[Instruction]:
        """Our own link is back: steps under way get their whole deadline again."""
        self._linked = True
        self._books.collector.wait_anew(now_ns)
        return self.tick(now_ns)

    def command(
        self, command: SetPose | Relocalize, now_ns: int
    ) -> tuple[CommandDone, list[Instruction]]:
        """A person says where the robot is, or to search everywhere; done once for each id."""
        instructions: list[Instruction] = []
        if command.command_id not in self._books.commands_done:
            if carry_out(command, self._books):
                self._succession.founded = True
                instructions += self._believed(now_ns)
            instructions += self.tick(now_ns)
        problem = self._books.commands_done[command.command_id]
        return CommandDone(sender=self._sender, problem=problem), instructions

    def tick(self, now_ns: int) -> list[Instruction]:
        """Apply the steps that are due and tell workers what is news to them."""
        if not self._linked or self.outranked_by is not None:
            return []
        books, instructions = self._books, list[Instruction](self._succession.questions(now_ns))
        if not self.begun:
            if not self._succession.may_begin(now_ns):
                return instructions
            instructions += self._begin(now_ns)
        while ready := books.collector.ready(
            books.placement.waited_for(books.ensemble.expected), books.placement.placed_ns, now_ns
        ):
            books.apply(ready, now_ns)
            instructions += self._believed(now_ns)
        orders = books.placement.orders(now_ns)
        if books.changed or orders:
            self._succession.founded |= len(books.ensemble.clusters) > 0
            first: list[Instruction] = [self._succession.hand_on(books.state(now_ns), now_ns)]
            books.changed = False
        else:
            first = list(self._succession.sign_of_life(now_ns))
        return [*first, *(SendOrder(worker, order) for worker, order in orders), *instructions]

    # --- answers

    def pose(self, now_ns: int) -> PoseAnswer:
        """Where the robot is now."""
        return self._spokesman.pose(now_ns)

    def hypotheses(self, now_ns: int) -> Hypotheses:
        """All places with their probabilities."""
        return self._spokesman.hypotheses(now_ns)

    def status(self, now_ns: int, counters: dict[str, int]) -> Status:
        """How the system is; `counters` are those of the process around."""
        return self._spokesman.status(now_ns, counters)

    def _believed(self, now_ns: int) -> list[Instruction]:
        """Tell what is believed now."""
        belief = self._spokesman.belief()
        return [PublishBelief(belief, self.pose(now_ns))] if belief is not None else []

    def _say_again(self, scan: Scan, now_ns: int) -> list[Instruction]:
        """A step that comes again waits for its belief, which may have been lost."""
        applied = self._books.applied_scan
        if not scan.paced or applied is None or scan.step != applied.step:
            return []
        return self._believed(now_ns)

    # --- the beginning

    def _begin(self, now_ns: int) -> list[Instruction]:
        """All has been heard: carry on from another's state, or begin anew."""
        self._succession.begun = self._books.changed = True
        self._spokesman.term = self._succession.term
        self._books.placement.rule(self._succession.term)
        newest = self._succession.newest
        instructions = self._resume(newest, now_ns) if newest is not None else []
        if not instructions:
            for worker in self._succession.told:
                self._books.placement.held(worker, (), now_ns)
            waiting = self._books.collector.oldest_scan
            if waiting is not None:
                self._begin_search(waiting)
            else:
                instructions.append(FetchScans(0, None))
        for report, worker in self._early_reports:
            self._books.take(report, worker)
        self._early_reports.clear()
        return instructions

    def _begin_search(self, scan: Scan) -> None:
        """The first search begins with this scan, or those that were lost just before it."""
        if self._books.ensemble.searches:
            return
        before = self._books.collector.before
        lost = 0 if before is None else scan.step - before - 1
        first = scan.step - (lost if lost <= NEVER_LATER else 0)
        self._books.begin_search(first, self._offer(scan))

    def _offer(self, scan: Scan) -> OfferState | None:
        """Where the robot was at the end of an earlier life, as one place that is possible."""
        last = self._last_poses.get(scan.map_digest)
        probability = self._settings.last_pose_probability
        return last.offered_at(scan, probability) if last and probability > 0.0 else None

    def _resume(self, checkpoint: Checkpoint, now_ns: int) -> list[Instruction]:
        """Carry on from another's state; nothing is done if it cannot be used.

        The belief that was last is published again: the one before may not have come to it.
        """
        next_step = self._books.resume(checkpoint, now_ns)
        if next_step is None:
            return []
        self._succession.founded = checkpoint.founded
        for worker, told in self._succession.told.items():
            self._hear_out(worker, told, now_ns)
        return [FetchScans(next_step, None), *self._believed(now_ns)]

    def _hear_out(self, worker: str, told: Told, now_ns: int) -> None:
        """Take what a worker holds, and what it has reported while nobody was there."""
        self._books.placement.held(worker, told.holds, now_ns)
        for report in told.reports:
            self._books.take(report, worker)
