"""A coordinator process: stands by, takes over, acts, steps down; its real parts, simulated links.

What happens between the parts is what `coordinator.process`, `coordinator.loop` and
`coordinator.standby` do with Zenoh.
"""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from coordinator import events
from coordinator.coordinator import Coordinator
from coordinator.failover.failure_detector import FailureDetector
from coordinator.failover.self_fencing import SelfFencing
from coordinator.failover.state_recovery import told_by
from coordinator.instructions import (
    AskState,
    FetchMap,
    FetchScans,
    Instruction,
    PublishBelief,
    PublishCheckpoint,
    SendOrder,
)
from coordinator.membership.membership import Membership
from coordinator.newest_checkpoint import NewestCheckpoint
from coordinator.recorder.records import Started
from protocol.codec import encode
from protocol.steps import OdometryReading, Scan
from protocol.terms import check_term
from protocol.work import Checkpoint, OrderAnswer, Report, WorkerState
from tests.simulation.laws import Laws, Life
from tests.simulation.network import Node
from tests.simulation.world import COORDINATOR, SETTINGS
from tests.unit.coordinator.reports import free_everywhere

if TYPE_CHECKING:
    from tests.simulation.simulation import Simulation

TICK_S = 0.19
ALIVE = "coordinator"
WRITING_S = 0.02


class CoordinatorNode(Node):
    """One process that coordinates, or stands by."""

    def __init__(self, name: str, simulation: "Simulation", offset_s: float, wall_us: int) -> None:
        super().__init__(name, simulation.clock, offset_s)
        self._simulation, self._wall_us = simulation, wall_us
        self.coordinator: Coordinator | None = None
        self._life: Life | None = None
        self._detector: FailureDetector | None = None
        self._newest = NewestCheckpoint()
        self._promptest_s = math.inf
        self._is_deposed = False
        self.file: Checkpoint | None = None
        """It outlives the process."""

    @property
    def laws(self) -> Laws:
        """What everything is held against."""
        return self._simulation.laws

    @property
    def acts(self) -> bool:
        """Whether it has begun, and knows of none above it."""
        return bool(self.alive and self.coordinator and self.coordinator.begun)

    def _now_us(self) -> int:
        return self._wall_us + self.clock.now_ns // 1_000

    # --- a process's life

    def start(self) -> None:
        """Look whether somebody coordinates."""
        self.coordinator = self._detector = None
        if not self.linked:
            self.later(TICK_S, self.start)
        elif self._is_deposed or any(
            token.startswith(ALIVE) for token in self._simulation.network.tokens
        ):
            self._detector = FailureDetector(COORDINATOR.take_over_after_s, self.now_ns)
            self._simulation.network.watch(self)
            self.later(TICK_S, self._tick)
        else:
            self._lead()

    def _lead(self) -> None:
        self._detector, self._is_deposed, self._written_term = None, False, 0
        self.session += 1
        started = Started(
            sender=self.name,
            filter_settings=SETTINGS,
            settings=COORDINATOR,
            version="test",
            now_ns=self.now_ns,
            # Simulated processes start at round times, real ones never at the same microsecond.
            term=self._now_us() + 1_009 * self.session + int(self.name[-1]),
            known=self._newest.checkpoint,
            usual_delay_ns=self._newest.usual_delay_ns,
            kept=self.file,
        )
        self.coordinator = started.coordinator()
        self._life = self.laws.life(self.name, started, self.coordinator, self._promptest_s)
        self._newest, self._promptest_s = NewestCheckpoint(), math.inf
        self._membership, self._fencing = Membership(), SelfFencing(self.now_ns)
        self._simulation.network.watch(self)
        self.later(TICK_S, self._tick)

    def _tick(self) -> None:
        if self._detector is not None:
            if self._detector.is_over(self.now_ns):
                self._lead()
                return
        else:
            self._turn(lambda now_ns: self._handle(events.TimePassed(), now_ns))
        if self.coordinator is not None or self._detector is not None:
            self.later(TICK_S, self._tick)

    def _step_down(self) -> None:
        """Another acts: begin again as one that waits."""
        self._simulation.network.undeclare(self)
        self.life += 1
        self.session += 1
        self.coordinator, self._is_deposed = None, True
        self.later(TICK_S, self.start)

    def end(self) -> None:
        """Be killed."""
        super().end()
        self._is_deposed = False
        self._newest, self._promptest_s = NewestCheckpoint(), math.inf

    # --- what arrives

    def on_token(self, name: str, alive: bool) -> None:
        """A worker, or a coordinator."""
        if self._detector is not None and name.startswith(ALIVE):
            if alive:
                self._detector.sign_of_life(self.now_ns)
            else:
                self._detector.token_vanished(self.now_ns)
        elif self.coordinator is not None and name.startswith("w"):

            def change(now_ns: int) -> list[Instruction]:
                changes = self._membership.token(name, alive, now_ns)
                return [do for one in changes for do in self._handle(one, now_ns)]

            self._turn(change)

    def on_link(self, up: bool) -> None:
        """As the loops do."""
        if self._detector is not None:
            self._detector.link(up, self.now_ns)
        elif self.coordinator is not None:

            def change(now_ns: int) -> list[Instruction]:
                was_linked = self._membership.linked
                self._membership.link(up, now_ns)
                if up == was_linked:
                    return []
                if up:
                    self._fencing.listen(now_ns)
                return self._handle(events.LinkBack() if up else events.LinkLost(), now_ns)

            self._turn(change)

    def on_checkpoint(self, checkpoint: Checkpoint) -> None:
        """Another coordinator's."""
        check_term(checkpoint, self._now_us() * 1_000)
        if is_newest := self._newest.hear(checkpoint, self.now_ns):
            self._promptest_s = min(self._promptest_s, self.laws.unknown_s(checkpoint))
        if self._detector is not None:
            if is_newest:
                self._detector.sign_of_life(self.now_ns)
        else:
            self.tell(events.CheckpointHeard(checkpoint))

    def on_scan(self, scan: Scan) -> None:
        """A step."""
        self.tell(events.ScanArrived(scan))

    def on_odometry(self, reading: OdometryReading) -> None:
        """The robot moves."""
        self.tell(events.OdometryArrived(reading))

    def on_report(self, worker: str, report: Report) -> None:
        """A job took a step."""
        self.tell(events.ReportArrived(worker, report))

    def on_order_answer(self, worker: str, answer: OrderAnswer) -> None:
        """A worker has an order, or refuses it."""
        check_term(answer, self._now_us() * 1_000)
        self.tell(events.OrderAnswered(worker, answer))

    def on_state(self, worker: str, state: WorkerState, heard_term: int) -> None:
        """A worker tells what it knows."""
        if self._life is not None and self.coordinator is not None:
            if not self.coordinator.begun:
                self._life.heard_terms.append(heard_term)
            told = told_by(encode(state), self._now_us() * 1_000)
            self.tell(events.WorkerToldState(worker, told))

    def on_pose_asked(self) -> None:
        """An observer asks; its answer is held against the truth at once."""
        if self.coordinator is None or self._life is None or not self.coordinator.begun:
            return
        if not self._fencing.is_listening(self.now_ns):
            self.laws.pose_told(self._life, self.coordinator.pose(self.now_ns))

    def tell(self, event: events.Event) -> None:
        """Something happened."""
        if self.coordinator is not None:
            self._turn(lambda now_ns: self._handle(event, now_ns))

    # --- what comes of it

    def _turn(self, happen: Callable[[int], list[Instruction]]) -> None:
        now_ns = self.now_ns
        self._fencing.turn(now_ns)
        self._carry_out(happen(now_ns), now_ns)
        for change in self._membership.due(now_ns):
            self._carry_out(self._handle(change, now_ns), now_ns)
        if self.coordinator is None:
            return
        if self.coordinator.outranked_by is not None:
            self._step_down()
        elif self.coordinator.begun and self.token is None:
            self._simulation.network.declare(self, f"{ALIVE} {self.name}")

    def _handle(self, event: events.Event, now_ns: int) -> list[Instruction]:
        assert self.coordinator is not None
        assert self._life is not None
        instructions = self.coordinator.handle(event, now_ns)
        self._life.handled(event, now_ns, instructions)
        return instructions

    def _carry_out(self, instructions: list[Instruction], now_ns: int) -> None:
        assert self.coordinator is not None
        if self.coordinator.outranked_by is not None:
            return
        simulation = self._simulation
        for instruction in self._fencing.cleared(instructions, now_ns):
            self.laws.carried_out(self._life, instruction)
            match instruction:
                case PublishBelief(belief):
                    self.laws.believed(belief)
                case PublishCheckpoint(checkpoint):
                    self._keep_later(checkpoint)
                    simulation.publish_checkpoint(self, checkpoint)
                case SendOrder(worker, order):
                    simulation.send_order(self, worker, order)
                case AskState(worker, question):
                    simulation.send_take_over(self, worker, question)
                case FetchMap():
                    ground = free_everywhere(self.coordinator.map_digest)
                    simulation.ask_bridge(
                        self,
                        lambda _bridge, ground=ground: lambda: self.tell(events.MapArrived(ground)),  # type: ignore[misc]
                    )
                case FetchScans(first, last):
                    simulation.ask_bridge(
                        self,
                        lambda bridge, first=first, last=last: self._arrived(  # type: ignore[misc]
                            bridge.history(first, last)
                        ),
                    )

    def _keep_later(self, checkpoint: Checkpoint) -> None:
        """Write the first state of a term at once; later ones unless the process dies before."""

        def write() -> None:
            if self.file is None or checkpoint.rank > self.file.rank:
                self.file = checkpoint

        if checkpoint.term == self._written_term:
            self.later(self._simulation.rng.uniform(0.0, WRITING_S), write)
        else:
            self._written_term = checkpoint.term
            write()

    def _arrived(self, scans: tuple[Scan, ...]) -> Callable[[], None]:
        return lambda: self.tell(events.HistoryArrived(scans))
