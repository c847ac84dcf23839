"""A coordinator's snapshot makes objects of ours, and nothing else."""

import pickle
from pathlib import Path

import pytest

from coordinator.events import ScanArrived, WorkerJoined, WorkerLeft
from coordinator.recorder.snapshot import freeze, thaw
from tests.unit.coordinator.recorder.test_blocks import head
from tests.unit.coordinator.reports import scan


class Trap:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self.path,)


def test_a_fresh_coordinator_is_restored() -> None:
    coordinator = head().started.coordinator()
    coordinator.handle(WorkerJoined("w0"), 1)
    coordinator.handle(WorkerLeft("w0"), 2)
    restored = thaw(freeze(coordinator))
    assert (
        restored.handle(ScanArrived(scan(0)), 3)
        == coordinator.handle(ScanArrived(scan(0)), 3)
        != []
    )


def test_a_snapshot_calls_nothing_that_is_not_ours(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="is no part of a coordinator"):
        thaw(pickle.dumps(Trap(tmp_path / "trap")))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["time.sleep", "loop.time.sleep", "PATIENCE_NS", "told_by"])
def test_of_our_modules_only_classes_are_taken(name: str) -> None:
    module = "coordinator.failover.state_recovery"
    data = b"\x80\x04\x8c%c%s\x8c%c%s\x93." % (
        len(module),
        module.encode(),
        len(name),
        name.encode(),
    )
    with pytest.raises(ValueError, match="not a coordinator's snapshot"):
        thaw(data)


@pytest.mark.parametrize("data", [b"", b"nonsense", pickle.dumps(7)])
def test_what_is_no_snapshot_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match="not a coordinator's snapshot"):
        thaw(data)
