"""A coordinator process: the product's `Replica` at the end of a simulated link."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from clustermcl.coordinator import events
from clustermcl.coordinator import instructions as do
from clustermcl.coordinator.coordinator import Coordinator
from clustermcl.coordinator.replica import Replica
from clustermcl.coordinator.report_checks import without_malformed_jobs
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import Checkpoint, OrderAnswer, WorkerState, check_term
from tests.simulation.laws import Laws, Life
from tests.simulation.network import Action, Node
from tests.simulation.world import COORDINATOR, SETTINGS
from tests.unit.coordinator.reports import free_everywhere, started

if TYPE_CHECKING:
    from tests.simulation.processes import Bridge
    from tests.simulation.simulation import Simulation

TICK_S = 0.19
ALIVE = "coordinator"
WRITING_S = 0.02


class CoordinatorNode(Node):
    def __init__(self, name: str, simulation: "Simulation", offset_s: float, wall_us: int) -> None:
        super().__init__(name, simulation.clock, offset_s)
        self._simulation, self._wall_us = simulation, wall_us
        self._begin_process()
        self.file: Checkpoint | None = None
        """It outlives the process."""

    def _begin_process(self) -> None:
        self._replica = Replica(COORDINATOR.take_over_after_s, self.now_ns)
        self._is_running = False
        self._life: Life | None = None

    @property
    def laws(self) -> Laws:
        return self._simulation.laws

    @property
    def coordinator(self) -> Coordinator | None:
        return self._replica.coordinator

    @property
    def acts(self) -> bool:
        """Whether it has begun, and knows no coordinator of a higher term."""
        return self.alive and self._replica.role in ("leading", "deposed")

    def _now_us(self) -> int:
        return self._wall_us + self.clock.now_ns // 1_000

    # --- a process's life

    def start(self) -> None:
        self._is_running = False
        if not self.linked:
            self.later(TICK_S, self.start)
        elif self._replica.role == "deposed" or any(
            token.startswith(ALIVE) for token in self._simulation.network.tokens
        ):
            self._replica.follow(self.now_ns)
            self._run()
        else:
            self._lead()

    def _run(self) -> None:
        self._is_running = True
        self._simulation.network.watch(self)
        self.later(TICK_S, self._tick)

    def _lead(self) -> None:
        self._written_term = 0
        self.session += 1
        begun = started(
            sender=self.name,
            filter_settings=SETTINGS,
            settings=COORDINATOR,
            now_ns=self.now_ns,
            # Simulated processes start at round times, real ones never at the same microsecond.
            term=self._now_us() + 1_009 * self.session + int(self.name[-1]),
            known=self._replica.newest,
            kept=self.file,
        )
        coordinator = begun.coordinator()
        life = self._life = self.laws.life(self.name, begun, coordinator)

        def handle(event: events.Event, now_ns: int) -> list[do.Instruction]:
            life.handled(event)
            return coordinator.handle(event, now_ns)

        self._replica.lead(coordinator, self.now_ns, handle)
        self._run()

    def _tick(self) -> None:
        if self._replica.is_leader_dead(self.now_ns):
            self._lead()
            return
        self.pass_on(events.TimePassed())
        if self._is_running:
            self.later(TICK_S, self._tick)

    def _step_down(self) -> None:
        self._simulation.network.undeclare(self)
        self.life += 1
        self.session += 1
        self._is_running = False
        self.later(TICK_S, self.start)

    def end(self) -> None:
        super().end()
        self._begin_process()

    # --- messages

    def on_token(self, name: str, alive: bool) -> None:
        self.pass_on(events.TokenChanged(name if name.startswith("w") else None, alive))

    def on_link(self, up: bool) -> None:
        self.pass_on(events.LinkChanged(up))

    def on_checkpoint(self, checkpoint: Checkpoint) -> None:
        check_term(checkpoint, self._now_us() * 1_000)
        self.pass_on(events.CheckpointArrived(checkpoint))

    def on_scan(self, scan: Scan) -> None:
        self.pass_on(events.ScanArrived(scan))

    def on_answer(self, worker: str, answer: OrderAnswer | WorkerState, known_term: int) -> None:
        """Take the answer of a worker that knows of a belief of `known_term`."""
        check_term(answer, self._now_us() * 1_000)
        if isinstance(answer, OrderAnswer):
            self.pass_on(events.OrderAnswered(worker, answer))
        elif self._life is not None and self._replica.role != "follower":
            if self._replica.role == "recovering":
                self._life.known_terms.append(known_term)
            reported = without_malformed_jobs(decode(encode(answer), WorkerState))
            self.pass_on(events.WorkerStateArrived(worker, reported))

    def on_pose_asked(self) -> None:
        if self._life is not None and self._replica.may_answer(self.now_ns):
            self.laws.on_pose(self._life, self.coordinator.pose(self.now_ns))

    def pass_on(self, event: events.Event | events.TokenChanged | events.LinkChanged) -> None:
        if not self._is_running:
            return
        decided = self._replica.handle(event, self.now_ns)
        for instruction in self._replica.release(decided, self.now_ns):
            self._carry_out(instruction)
        if self._replica.role == "deposed":
            self._step_down()
        elif self._replica.role == "leading" and self.token is None:
            self._simulation.network.declare(self, f"{ALIVE} {self.name}")

    # --- instructions

    def _carry_out(self, instruction: do.Instruction) -> None:
        simulation = self._simulation
        self.laws.carried_out(self._life, instruction)
        match instruction:
            case Belief():
                self.laws.believed(instruction)
                simulation.publish_belief(self, instruction)
            case Checkpoint():
                self._keep_later(instruction)
                simulation.publish_checkpoint(self, instruction)
            case do.SendOrder(worker, question) | do.AskState(worker, question):
                simulation.ask_worker(self, worker, question)
            case do.FetchMap():
                ground = free_everywhere(self.coordinator.state.map_digest)
                self._ask_bridge(lambda _: events.MapArrived(ground))
            case do.FetchScans(first, last):
                self._ask_bridge(lambda bridge: events.HistoryArrived(bridge.history(first, last)))

    def _ask_bridge(self, answer: Callable[["Bridge"], events.Event]) -> None:
        def answered(bridge: "Bridge") -> Action:
            return partial(self.pass_on, answer(bridge))

        self._simulation.ask_bridge(self, answered)

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
