"""Which floor's map nav2's map_server has: another is loaded when the robot's floor is sure."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from clustermcl.protocol.answers import Belief

TIMEOUT_NS = 10_000_000_000
"""A map that is not loaded after this time is requested again at the next sure belief [ns]."""


@dataclass
class FloorMaps:
    """Requests the maps of floors, one after another."""

    files: Mapping[str, Path] = field(default_factory=dict)
    """Map file of each floor; empty for a single map."""
    loaded: str = ""
    """The floor whose map map_server has; empty: unknown."""
    problem: str = ""
    """Why the last request failed; empty: it did not."""
    asked: str = ""
    """The floor whose map was requested, and has not been loaded yet."""
    asked_ns: int = 0

    def on_belief(self, belief: Belief, now_ns: int) -> Path | None:
        """Return the map to load after a step; None: none."""
        floor, is_sure = belief.floor, belief.state == "localized"
        if not is_sure or self.asked or floor == self.loaded or floor not in self.files:
            return None
        self.asked, self.asked_ns = floor, now_ns
        return self.files[floor]

    def on_answer(self, problem: str) -> None:
        """Take map_server's answer; empty: it has loaded the map."""
        self.problem = f"floor {self.asked}: {problem}" if problem else ""
        if self.asked and not problem:
            self.loaded = self.asked
        self.asked = ""

    def waits(self, now_ns: int) -> bool:
        """Return whether map -> odom has to wait: map_server has the map of another floor."""
        if self.asked and now_ns - self.asked_ns > TIMEOUT_NS:
            self.on_answer(f"load_map has not answered for {TIMEOUT_NS // 10**9} s")
        return bool(self.asked)
