"""The lifecycle of a managed ROS 2 node: states and transitions."""

from dataclasses import dataclass
from enum import Enum


class State(Enum):
    """The states of a node, with ROS's numbers."""

    UNKNOWN = 0
    UNCONFIGURED = 1
    INACTIVE = 2
    ACTIVE = 3
    FINALIZED = 4
    CONFIGURING = 10
    CLEANINGUP = 11
    SHUTTINGDOWN = 12
    ACTIVATING = 13
    DEACTIVATING = 14
    ERRORPROCESSING = 15

    @property
    def label(self) -> str:
        return self.name.lower()


@dataclass(frozen=True)
class Transition:
    """A transition between two states, with ROS's number and name."""

    number: int
    label: str
    start: State
    goal: State


def _way(
    number: int, label: str, start: State, during: State, goal: State, done: int
) -> tuple[Transition, Transition]:
    """Return a requested transition to a transient state, and the one that follows it."""
    return (
        Transition(number, label, start, during),
        Transition(done, "transition_success", during, goal),
    )


CONFIGURE, ACTIVATE = 1, 3
"""The transitions that a node without a lifecycle manager makes by itself."""

_WAYS = (
    _way(CONFIGURE, "configure", State.UNCONFIGURED, State.CONFIGURING, State.INACTIVE, 10),
    _way(2, "cleanup", State.INACTIVE, State.CLEANINGUP, State.UNCONFIGURED, 20),
    _way(ACTIVATE, "activate", State.INACTIVE, State.ACTIVATING, State.ACTIVE, 30),
    _way(4, "deactivate", State.ACTIVE, State.DEACTIVATING, State.INACTIVE, 40),
    _way(5, "shutdown", State.UNCONFIGURED, State.SHUTTINGDOWN, State.FINALIZED, 50),
    _way(6, "shutdown", State.INACTIVE, State.SHUTTINGDOWN, State.FINALIZED, 50),
    _way(7, "shutdown", State.ACTIVE, State.SHUTTINGDOWN, State.FINALIZED, 50),
)

TRANSITION_GRAPH = tuple(dict.fromkeys(one for way in _WAYS for one in way))


class Lifecycle:
    """The state of one node."""

    def __init__(self) -> None:
        self.state = State.UNCONFIGURED

    def available(self) -> list[Transition]:
        return [asked for asked, _ in _WAYS if asked.start is self.state]

    def change(self, number: int, label: str = "") -> tuple[Transition, ...]:
        """Request a transition, and return those made; none if the state does not allow it.

        The label takes precedence over the number, as in ROS.
        """
        for asked, succeeded in _WAYS:
            meant = asked.label == label if label else asked.number == number
            if meant and asked.start is self.state:
                self.state = succeeded.goal
                return asked, succeeded
        return ()
