"""What a person asked of a soak."""

from dataclasses import dataclass
from pathlib import Path

from soak_test.robot import ROOMS
from soak_test.schedule import Kind


@dataclass(frozen=True, kw_only=True)
class SoakOptions:
    """The options of the command."""

    minutes: float
    robots: int
    coordinators: int
    """Of each robot; one acts, the others stand by."""
    rate_hz: float
    """Scans a second of each robot."""
    world: str
    chaos: bool
    fault_every_s: float
    only: tuple[Kind, ...]
    """Kinds of faults that are done; none named: all."""
    json_file: Path | None
    logs: Path | None
    """Folder to keep the processes' logs in."""

    @property
    def rooms(self) -> bool:
        """Whether the world is that of the eight rooms, where the number of places is known."""
        return self.world == ROOMS
