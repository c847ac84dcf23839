"""The bridge and the workers: their real cores, at the ends of simulated links."""

from collections import deque
from collections.abc import Callable
from operator import methodcaller
from typing import TYPE_CHECKING, TypeAlias

from clustermcl.coordinator.events import OdometryArrived, ReportArrived
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.errors import UnreachableError
from clustermcl.protocol.steps import KEPT_STEPS, LaserReading, OdometryReading, Reading, Scan
from clustermcl.protocol.work import Checkpoint, OrderAnswer, TakeOver, WorkerState, WorkOrder
from clustermcl.sensor_bridge.flow_control import FlowControl
from clustermcl.sensor_bridge.step_maker import StepMaker
from clustermcl.worker import worker as instructions
from clustermcl.worker.worker import Worker
from tests.simulation.network import Action, Asker, Node, ns
from tests.simulation.world import BRIDGE, MAP, scan_of
from tests.unit.coordinator.living import WorkerEvent

if TYPE_CHECKING:
    from tests.simulation.simulation import Simulation

QUIET_S = 0.01
"""A worker looks at checkpoints a little after the scan."""
KEPT_CHECKPOINTS = 4
FETCH_TIMEOUT_S = 0.5
STATUS_TIMEOUT_S = 5.0


class Bridge(Node):
    """Makes steps of scans with the product's gate and flow control, and keeps them."""

    def __init__(self, name: str, simulation: "Simulation", offset_s: float) -> None:
        super().__init__(name, simulation.clock, offset_s)
        self._simulation = simulation
        self._maker: StepMaker | None = None
        self.newest_step = -1
        self._begin()

    def _begin(self) -> None:
        self._history = deque[Scan](maxlen=KEPT_STEPS)
        self._flow = FlowControl(0.0 if self._simulation.schedule.lockstep else 1.0)
        self._coordinators = set[str]()
        self._asked_ns: int | None = None

    def start(self) -> None:
        self._begin()
        self._maker = None
        self._simulation.network.watch(self)

    @property
    def _asks(self) -> bool:
        """Whether it still asks for the step number, as `Bridge._status` of the product."""
        if self._maker is not None or self._simulation.acting() is not None:
            return False
        if self._asked_ns is None:
            self._asked_ns = self.now_ns
        is_there = self._flow.lockstep or bool(self._coordinators)
        return is_there and self.now_ns - self._asked_ns < ns(STATUS_TIMEOUT_S)

    def _made(self) -> StepMaker:
        """Make steps after the coordinator's newest step; from 0 without an answer."""
        if self._maker is None:
            acting = self._simulation.acting()
            known = acting.coordinator.status(acting.now_ns, {}).newest_step if acting else -1
            self._simulation.laws.restarts_count |= known < self.newest_step
            self.newest_step = known
            lockstep = self._flow.lockstep
            self._maker = StepMaker(
                BRIDGE, MAP.digest, self.name, known + 1, lockstep=lockstep, live=not lockstep
            )
        return self._maker

    def on_token(self, name: str, alive: bool) -> None:
        if not name.startswith("w"):  # all coordinators have the same token
            (self._coordinators.add if alive else self._coordinators.discard)(name)

    def on_belief(self, belief: Belief) -> None:
        self._flow.on_belief(
            belief.step, belief.term, self.now_ns, searching=belief.state == "searching"
        )

    def drive(self, number: int) -> bool:
        """Take the scan at the robot's place; return whether the robot may drive on."""
        if self.is_frozen or not self.alive:
            return True
        if self._flow.is_resend_due(self.now_ns):
            self._simulation.publish_scan(self, self._history[-1])
        if self._flow.lockstep and (self._flow.waits or not self._coordinators):
            return False
        if self._asks:
            return not self._flow.lockstep
        seen = scan_of(number)
        scan = self._on_reading(
            LaserReading(
                sender=self.name,
                stamp_ns=self.now_ns,
                ranges=seen.ranges,
                angle_min_rad=seen.angle_min_rad,
                angle_step_rad=seen.angle_step_rad,
                range_max_m=seen.range_max_m,
                robot_from_laser=seen.robot_from_laser,
                odom_from_robot=seen.odom_from_robot,
            )
        )
        if scan is not None:
            self.newest_step = scan.step
            self._history.append(scan)
            self._simulation.publish_scan(self, scan)
            self._flow.on_sent(scan.step, self.now_ns)
        return True

    def odometry(self, number: int) -> None:
        if self.is_frozen or not self.alive or self._flow.lockstep or self._asks:
            return
        pose = scan_of(number).odom_from_robot
        reading = OdometryReading(sender=self.name, stamp_ns=self.now_ns, odom_from_robot=pose)
        self._on_reading(reading)
        simulation = self._simulation
        simulation.laws.taken_ns[reading.stamp_ns] = simulation.clock.now_ns
        simulation.publish_to_coordinators(self, OdometryArrived(reading))

    def _on_reading(self, reading: Reading) -> Scan | None:
        is_live_scan = not self._flow.lockstep and isinstance(reading, LaserReading)
        maker = self._made()
        self._flow.set_gate(maker, self.now_ns, is_live_scan=is_live_scan)
        return maker.on_reading(reading)

    def history(self, first: int, last: int | None) -> tuple[Scan, ...]:
        return tuple(
            s for s in self._history if first <= s.step and (last is None or s.step <= last)
        )


Question: TypeAlias = WorkOrder | TakeOver
SLICE_S = 0.001
"""Duration of a slice of a search."""


class WorkerNode(Node):
    """A worker's core and what its loop does at its rim."""

    def __init__(self, name: str, simulation: "Simulation", offset_s: float) -> None:
        super().__init__(name, simulation.clock, offset_s)
        self._simulation = simulation
        self._unread: deque[Checkpoint] = deque(maxlen=KEPT_CHECKPOINTS)
        self.core = Worker(name)
        self.known_term = 0
        """The highest of a founded checkpoint that this process has had in its hands."""
        self._is_searching = False

    def start(self) -> None:
        self.core = Worker(self.name)
        self._is_searching = False
        self._unread.clear()
        self.known_term = 0
        self._simulation.network.declare(self, self.name)

    def on_scan(self, scan: Scan) -> None:
        self._handle(methodcaller("on_scan", scan))
        self.later(QUIET_S, self._read_checkpoints)

    def on_checkpoint(self, checkpoint: Checkpoint) -> None:
        self._unread.append(checkpoint)
        self.later(10 * QUIET_S, self._read_checkpoints)

    def on_asked(self, asker: Asker, question: Question) -> None:
        self._read_checkpoints()
        name = "on_order" if isinstance(question, WorkOrder) else "on_take_over"
        self._handle(methodcaller(name, asker, question))

    def jobs(self) -> set[tuple[str, int]]:
        """(job id, epoch) of what it does; nothing changes by asking."""
        no_coordinator = TakeOver(sender="nobody", term=0)
        (answer,) = self.core.on_take_over(-1, no_coordinator)
        return {(held.job_id, held.epoch) for held in answer.message.holds}

    def _read_checkpoints(self) -> None:
        while self._unread:
            checkpoint = self._unread.popleft()
            if checkpoint.founded:
                self.known_term = max(self.known_term, checkpoint.term)
            self._handle(methodcaller("on_checkpoint", checkpoint))

    def _handle(self, event: WorkerEvent) -> None:
        for instruction in event(self.core):
            self._carry_out(instruction)
        if self.core.searches and not self._is_searching:
            self._is_searching = True
            self.later(SLICE_S, self._search_on)

    def _search_on(self) -> None:
        self._is_searching = False
        self._handle(methodcaller("search"))

    def _carry_out(self, instruction: instructions.Instruction) -> None:
        simulation = self._simulation
        match instruction:
            case instructions.Answer(asker, OrderAnswer() | WorkerState() as answer):
                simulation.answer(self, asker, answer)
            case instructions.FetchMap():
                error = UnreachableError(peer="map", problem="nobody", waited_s=FETCH_TIMEOUT_S)
                self._ask_bridge(
                    lambda _: methodcaller("on_map", MAP), methodcaller("on_map_failure", error)
                )
            case instructions.BuildModel(map_message):
                built = methodcaller("on_model", map_message.digest, simulation.model)
                self.later(simulation.rng.uniform(0.0, 0.1), lambda: self._handle(built))
            case instructions.FetchScans(missing):
                self._ask_bridge(
                    lambda bridge: methodcaller(
                        "on_history", missing, bridge.history(missing.first, missing.last)
                    ),
                    methodcaller("on_no_history", missing, "nobody is there"),
                )
            case instructions.Warn() | instructions.Answer() | instructions.Advise():
                pass
            case report:
                simulation.publish_to_coordinators(self, ReportArrived(self.name, report))

    def _ask_bridge(self, answered: Callable[[Bridge], WorkerEvent], failed: WorkerEvent) -> None:
        """Whatever comes first happens: the answer, or the end of patience."""
        happened = list[bool]()

        def first(event: WorkerEvent) -> Action:
            def happen() -> None:
                if not happened:
                    happened.append(True)
                    self._handle(event)

            return happen

        self._simulation.ask_bridge(self, lambda bridge: first(answered(bridge)))
        self.later(FETCH_TIMEOUT_S, first(failed))
