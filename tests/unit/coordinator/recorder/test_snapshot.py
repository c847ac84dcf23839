import pickle
from pathlib import Path
from typing import Any

import hypothesis
import pytest
from hypothesis import strategies as st

from clustermcl.coordinator.coordinator import Coordinator, Started
from clustermcl.coordinator.events import Event
from clustermcl.coordinator.instructions import Instruction, PublishBelief
from clustermcl.coordinator.recorder.records import freeze, without_bulk
from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.conversion import decoded
from tests.unit.coordinator.living import Living
from tests.unit.coordinator.recorder.test_replay import ACTIONS, live

ROOT = Path(__file__).parents[4]
PACKAGES = [path.parent for path in ROOT.glob("*/__init__.py") if path.parent.name != "tests"]


class Watched:
    """A coordinator, and one made from its snapshots, which must publish the same beliefs."""

    def __init__(self, started: Started) -> None:
        self._coordinator, self._thawed = started.coordinator(), started.coordinator()
        self._events = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._coordinator, name)

    def handle(self, event: Event, now_ns: int) -> list[Instruction]:
        instructions = self._coordinator.handle(event, now_ns)
        again = self._thawed.handle(without_bulk(event), now_ns)
        assert beliefs(again) == beliefs(instructions)
        self._events += 1
        if self._events % 7 == 0:
            self._thawed = decoded(freeze(self._coordinator), Coordinator)
        return instructions


def beliefs(instructions: list[Instruction]) -> list[Belief]:
    return [do.belief for do in instructions if isinstance(do, PublishBelief)]


@hypothesis.settings(deadline=None, max_examples=8)
@hypothesis.given(st.lists(ACTIONS, min_size=5, max_size=30))
def test_a_coordinator_from_a_snapshot_publishes_the_same_beliefs(
    model: SensorModel, actions: list[tuple[str, int]]
) -> None:
    def made(started: Started) -> Coordinator:
        return Watched(started)  # type: ignore[return-value] # it behaves as one

    live(Living(model, made=made), [*[("drive", 0)] * 8, *actions])


@pytest.mark.parametrize("data", [b"", b"nonsense", pickle.dumps(7), b"\x91" * 100_000])
def test_bytes_that_are_not_a_snapshot_are_refused(data: bytes) -> None:
    with pytest.raises((ValueError, RecursionError)):
        decoded(data, Coordinator)


@pytest.mark.parametrize(
    "words", ["allow_pickle=True", "__import__(", "unsafe_load", "UnsafeLoader", "FullLoader"]
)
def test_no_module_of_the_product_creates_any_object_that_a_file_names(words: str) -> None:
    """Ruff refuses imports of pickle and the like, and eval and exec."""
    files = [file for package in PACKAGES for file in package.rglob("*.py")]
    assert [file for file in files if words in file.read_text()] == []
