"""One robot's processes on a simulated network, for one schedule that a seed decides."""

import random
from collections.abc import Callable, Iterable
from functools import partial
from typing import TypeVar

from clustermcl.coordinator import events
from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import Checkpoint, OrderAnswer, WorkerState
from tests.simulation.coordinator_node import CoordinatorNode
from tests.simulation.laws import LawBrokenError, Laws, demand
from tests.simulation.network import SECOND, Action, Asker, Clock, Network, Node, ns
from tests.simulation.processes import Bridge, Question, WorkerNode
from tests.simulation.schedule import Schedule

N = TypeVar("N", bound=Node)
WELL_WITHIN_S = 20.0
"""After the last fault."""


class Simulation:
    def __init__(self, seed: int, model: SensorModel) -> None:
        self.seed, self.model = seed, model
        self.rng = random.Random(seed)
        self.clock = Clock()
        self.network = Network(self.clock, self.rng)
        self.schedule = Schedule(self.rng)
        self.laws = Laws(self.clock, live=not self.schedule.lockstep)
        network, plan = self.network, self.schedule
        network.loss, network.doubled = plan.loss, plan.doubled
        network.least_s, network.jitter_s = plan.least_s, plan.jitter_s
        self.bridge = Bridge("bridge", self, plan.offset_s(self.rng))
        self.workers = {
            name: WorkerNode(name, self, plan.offset_s(self.rng))
            for name in (f"w{n}" for n in range(plan.workers))
        }
        self.coordinators = {
            name: CoordinatorNode(name, self, plan.offset_s(self.rng), wall_us)
            for name, wall_us in zip(("c0", "c1"), plan.wall_us, strict=True)
        }
        network.nodes = {
            node.name: node
            for node in (self.bridge, *self.workers.values(), *self.coordinators.values())
        }
        self._driven = 0
        self.stands = False
        """Whether the robot stands for a while."""
        self._is_calm, self._trouble = False, "faults"

    def acting(self) -> CoordinatorNode | None:
        """The coordinator whose beliefs count; None while there is none."""
        acting = [node for node in self.coordinators.values() if node.acts]
        return max(acting, key=lambda node: node.coordinator.status(0, {}).term, default=None)

    # --- a schedule

    def run(self) -> None:
        try:
            self._run()
        except LawBrokenError as error:
            raise LawBrokenError(f"seed {self.seed}, {self._at()}: {error}") from None
        except Exception as error:
            error.add_note(f"seed {self.seed}, {self._at()}")
            raise

    def _at(self) -> str:
        return f"at {self.clock.now_ns / SECOND:.3f} s"

    def _run(self) -> None:
        for node in self.network.nodes.values():
            self.clock.after(self.rng.uniform(0.0, 0.05), node.start)
        self.clock.after(0.1, self._drive)
        self.clock.after(0.15, self._move)
        for at_s, fault in self.schedule.faults:
            self.clock.after(at_s, lambda fault=fault: fault(self))  # type: ignore[misc]
        while self.clock.now_ns < ns(self.schedule.calm_at_s):
            self.clock.step()
        self._calm()
        until_ns = self.clock.now_ns + ns(WELL_WITHIN_S)
        while self._trouble:
            demand(self.clock.now_ns < until_ns, f"all is well in the end, not: {self._trouble}")
            self.clock.step()

    def _calm(self) -> None:
        self._is_calm = True
        network = self.network
        network.loss = network.doubled = 0.0
        for node in network.nodes.values():
            node.slow_s = 0.0
            if node.is_frozen:
                node.thaw()
            network.mend(node)
            network.start(node)

    def _look(self) -> str:  # noqa: PLR0911 - one for each trouble
        """The faults that are active just before a step."""
        acting = [node for node in self.coordinators.values() if node.acts]
        if len(acting) != 1:
            return f"{len(acting)} coordinators act"
        coordinator = acting[0].coordinator
        status = coordinator.status(acting[0].now_ns, {})
        newest = self.bridge.newest_step
        if status.step != newest:
            return f"step {status.step} is believed, {newest} was driven"
        if set(status.workers) != set(self.workers):
            return f"workers {sorted(status.workers)} are known"
        jobs = coordinator.state.placement.jobs
        if waiting := jobs.by_worker().get(None):
            return f"no worker has {sorted(waiting)}"
        if missing := coordinator.state.pose.outcome.missing:
            return f"no report of {missing}"
        for name, worker in self.workers.items():
            given = set(jobs.by_worker().get(name, {}).items())
            if worker.jobs() != given:
                return f"{name} has {sorted(worker.jobs())}, should have {sorted(given)}"
        return ""

    def _drive(self) -> None:
        if self._is_calm:
            self._trouble = self._look()
        self._driven += self.bridge.drive(self._driven) and not self.stands
        self.clock.after(self.schedule.period_s, self._drive)

    def _move(self) -> None:
        self.bridge.odometry(self._driven)
        for node in self.coordinators.values():
            node.take(node.on_pose_asked)
        self.clock.after(0.31, self._move)

    # --- what goes over the network

    def _publish(self, source: Node, nodes: Iterable[N], received: Callable[[N], None]) -> None:
        for node in nodes:
            self.network.send(source, node, partial(received, node))

    def publish_scan(self, source: Bridge, scan: Scan) -> None:
        self.laws.taken_ns.setdefault(scan.stamp_ns, self.clock.now_ns)
        nodes: list[CoordinatorNode | WorkerNode]
        nodes = [*self.coordinators.values(), *self.workers.values()]
        self._publish(source, self._shuffled(nodes), lambda node: node.on_scan(scan))

    def publish_to_coordinators(self, source: Node, event: events.Event) -> None:
        self._publish(source, self.coordinators.values(), lambda node: node.pass_on(event))

    def publish_belief(self, source: CoordinatorNode, belief: Belief) -> None:
        self._publish(source, [self.bridge], lambda node: node.on_belief(belief))

    def publish_checkpoint(self, source: CoordinatorNode, checkpoint: Checkpoint) -> None:
        received = decode(encode(checkpoint), Checkpoint)
        workers = self._shuffled(self.workers.values())
        others = [node for node in self.coordinators.values() if node is not source]
        self._publish(source, workers, lambda node: node.on_checkpoint(received))
        self._publish(source, others, lambda node: node.on_checkpoint(received))

    def ask_worker(self, source: CoordinatorNode, name: str, question: Question) -> None:
        worker, asker = self.workers[name], Asker.now(source)
        self.network.send(source, worker, lambda: worker.on_asked(asker, question))

    def answer(self, source: WorkerNode, asker: Asker, answer: OrderAnswer | WorkerState) -> None:
        node, term = self.coordinators[asker.name], source.known_term
        received = asker.waiting(node, lambda: node.on_answer(source.name, answer, term))
        self.network.send(source, node, received)

    def ask_bridge(self, source: Node, answer: Callable[[Bridge], Action]) -> None:
        """A query to the bridge; `answer` makes of it what happens where it was asked."""
        bridge, asker = self.bridge, Asker.now(source)

        def asked() -> None:
            self.network.send(bridge, source, asker.waiting(source, answer(bridge)))

        self.network.send(source, bridge, asked)

    def _shuffled(self, nodes: Iterable[N]) -> list[N]:
        shuffled = list(nodes)
        self.rng.shuffle(shuffled)
        return shuffled
