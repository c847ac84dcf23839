"""What a bridge takes, and from what it takes it where no robot publishes it."""

from typing import Protocol, TypeAlias

from protocol.steps import LaserReading, OdometryReading

Reading: TypeAlias = OdometryReading | LaserReading


class Source(Protocol):
    """Where readings come from when no robot publishes them."""

    steps: int | None
    """How many steps it makes; None: it does not end by itself."""

    def next_reading(self) -> Reading | None:
        """The next reading in the order of time; None at the end."""
