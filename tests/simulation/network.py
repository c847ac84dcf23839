"""A network with a clock of its own: processes, the links between them, and what goes wrong.

Nothing here waits. Whatever happens is an action at a time, and the seed alone decides when: a
thousand schedules take a minute, and each can be run again.
"""

import heapq
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count

Action = Callable[[], None]
SECOND = 1_000_000_000
LEASE_NS = 2 * SECOND
"""The router closes a link that was silent for longer than this."""


def ns(seconds: float) -> int:
    return int(seconds * SECOND)


class Clock:
    def __init__(self) -> None:
        self.now_ns = 0
        self._due: list[tuple[int, int, Action]] = []
        self._numbers = count()

    def after(self, delay_s: float, action: Action) -> None:
        heapq.heappush(self._due, (self.now_ns + ns(delay_s), next(self._numbers), action))

    def step(self) -> None:
        self.now_ns, _, action = heapq.heappop(self._due)
        action()


class Node:
    """A process, at the end of a link to the router.

    What arrives while it is frozen waits for it; what arrives while it is dead is lost.
    """

    def __init__(self, name: str, clock: Clock, offset_s: float) -> None:
        self.name, self.clock, self._offset_ns = name, clock, ns(offset_s)
        self.alive = self.linked = True
        self.is_frozen = self.cut_in = self.cut_out = False
        self.slow_s = 0.0
        """How much later than others' what this one says arrives."""
        self.life = 0
        """How often it has ended."""
        self.session = 0
        """Number of its subscriptions; earlier messages do not arrive."""
        self.token: str | None = None
        """Its liveliness token, while it has one."""
        self._held: deque[tuple[int, Action]] = deque()

    @property
    def now_ns(self) -> int:
        return self.clock.now_ns + self._offset_ns

    def take(self, action: Action) -> None:
        if self.is_frozen:
            self._held.append((self.session, action))
        elif self.alive:
            action()

    def later(self, delay_s: float, action: Action) -> None:
        life = self.life
        self.clock.after(delay_s, lambda: self.take(action) if self.life == life else None)

    def thaw(self) -> None:
        self.is_frozen = False
        while self._held and not self.is_frozen:
            session, action = self._held.popleft()
            if self.alive and session == self.session:
                action()

    def end(self) -> None:
        self.alive = self.is_frozen = False
        self.life += 1
        self.session += 1
        self._held.clear()

    # --- what a process does at its rim

    def start(self) -> None:
        """Begin, knowing nothing."""

    def on_token(self, name: str, alive: bool) -> None:
        """Another process's liveliness token appeared or vanished."""

    def on_link(self, up: bool) -> None:
        """The own link to the router came up or was lost."""


@dataclass(frozen=True, slots=True)
class Asker:
    """The origin of a query; the answer reaches it only in the same session."""

    name: str
    session: int

    @classmethod
    def now(cls, node: Node) -> "Asker":
        return cls(node.name, node.session)

    def waiting(self, node: Node, action: Action) -> Action:
        """What an answer does at the node, if that still waits for it."""
        return lambda: action() if node.session == self.session else None


class Network:
    """The router and all links: messages are lost, late, doubled and overtaken."""

    def __init__(self, clock: Clock, rng: random.Random) -> None:
        self.clock, self._rng = clock, rng
        self.nodes: dict[str, Node] = {}
        self.tokens: dict[str, Node] = {}
        """What the router knows to be alive, and whose it is."""
        self.loss, self.doubled = 0.0, 0.0
        self.least_s, self.jitter_s = 0.0005, 0.002

    def send(self, source: Node, target: Node, action: Action) -> None:
        for _ in range(2 if self._rng.random() < self.doubled else 1):
            if not (source.cut_out or self._rng.random() < self.loss):
                delay_s = self._delay_s() + source.slow_s
                self.clock.after(delay_s, lambda: None if target.cut_in else target.take(action))

    def _delay_s(self) -> float:
        return self.least_s + min(self._rng.expovariate(1.0), 4.0) * self.jitter_s

    # --- liveliness: what the router says of it arrives, or is made good after the link is back

    def declare(self, node: Node, token: str) -> None:
        """A token for as long as its process and its link live."""
        node.token = token
        if node.linked:
            self.tokens[token] = node
            self._notify_others(node, token, alive=True)

    def undeclare(self, node: Node) -> None:
        self._forget(node)
        node.token = None

    def kill(self, node: Node) -> None:
        node.end()
        self.undeclare(node)

    def start(self, node: Node) -> None:
        if not node.alive:
            node.alive, node.linked = True, not (node.cut_in or node.cut_out)
            node.start()

    def _forget(self, node: Node) -> None:
        if node.token is not None and self.tokens.get(node.token) is node:
            del self.tokens[node.token]
            self._notify_others(node, node.token, alive=False)

    def watch(self, node: Node) -> None:
        for token in self.tokens:
            self._handle(node, token, alive=True)

    def _notify_others(self, node: Node, token: str, *, alive: bool) -> None:
        for other in self.nodes.values():
            if other is not node and other.linked:
                self._handle(other, token, alive=alive)

    def _handle(self, node: Node, token: str, *, alive: bool) -> None:
        node.later(self.least_s, lambda: node.on_token(token, alive))

    # --- links

    def cut(self, node: Node, *, inwards: bool, outwards: bool) -> None:
        """Block a link; after a while it counts as broken."""
        node.cut_in, node.cut_out = inwards, outwards
        self._break_later(node, lambda: node.cut_in or node.cut_out)

    def freeze(self, node: Node, seconds: float) -> None:
        """Stop a process, and let it go on later."""
        if not node.alive or node.is_frozen:
            return
        node.is_frozen = True
        life = node.life
        self._break_later(node, lambda: node.is_frozen)
        self.clock.after(seconds, lambda: self._go_on(node) if node.life == life else None)

    def _go_on(self, node: Node) -> None:
        node.thaw()
        self.mend(node)

    def _break_later(self, node: Node, is_silent: Callable[[], bool]) -> None:
        life = node.life

        def look() -> None:
            if node.life == life and node.linked and is_silent():
                self._break(node)

        self.clock.after(LEASE_NS / SECOND, look)

    def _break(self, node: Node) -> None:
        for token, owner in self.tokens.items():
            if owner is not node:
                self._handle(node, token, alive=False)
        node.linked = False
        node.later(2 * self.least_s, lambda: node.on_link(up=False))
        self._forget(node)

    def mend(self, node: Node) -> None:
        """Unblock a link; a broken one is opened again."""
        node.cut_in = node.cut_out = False
        if node.linked or not node.alive or node.is_frozen:
            return
        node.linked = True
        node.later(3 * self.least_s, lambda: self._linked_again(node))

    def _linked_again(self, node: Node) -> None:
        node.on_link(up=True)
        if node.token is not None:
            self.declare(node, node.token)
        self.watch(node)
