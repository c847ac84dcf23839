"""The states of a managed ROS 2 node."""

from enum import Enum


class State(Enum):
    """The lasting states, with ROS's numbers."""

    UNCONFIGURED = 1
    INACTIVE = 2
    ACTIVE = 3
    FINALIZED = 4

    @property
    def label(self) -> str:
        return self.name.lower()
