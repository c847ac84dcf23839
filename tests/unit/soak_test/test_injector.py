"""Faults, done to real processes that only sleep."""

import signal
import subprocess
import sys
from collections.abc import Iterator

import psutil
import pytest

from soak_test.fleet import COORDINATOR, WORKER, Part
from soak_test.injector import TRY_FOR_S, Injector, RobotSide
from soak_test.schedule import Fault, Kind

BOTH = Fault(at_s=1.0, kind=Kind.WORKER_AND_COORDINATOR_KILLED, lasts_s=0.0, choice=0.3)
AT_NS = 1_000_000_000


@pytest.fixture
def sleepers() -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    command = [sys.executable, "-I", "-S", "-c", "import time; time.sleep(600)"]
    started = {name: subprocess.Popen(command) for name in ("coordinator", "worker-0", "worker-1")}
    yield started
    for process in started.values():
        process.kill()
        process.wait()


def injector(sleepers: dict[str, subprocess.Popen[bytes]], trackers: list[str]) -> Injector:
    side = RobotSide(
        trackers=lambda _: trackers,
        acting=lambda: "coordinator",
        seen={},
        say=lambda _key, _payload: None,
        ask=lambda _key, _payload: None,
    )
    parts = [
        Part("r", role, f"r/{name}", psutil.Process(sleepers[name].pid))
        for role, name in (
            (COORDINATOR, "coordinator"), (WORKER, "worker-0"), (WORKER, "worker-1")
        )
    ]  # fmt: skip
    return Injector([BOTH], 0, {"r": side}, lambda: parts, seed=1)


def test_a_worker_and_the_coordinator_are_killed_at_once_and_told_one_by_one(
    sleepers: dict[str, subprocess.Popen[bytes]],
) -> None:
    done = injector(sleepers, ["worker-1"]).tick(AT_NS)
    assert [(fault.kind, fault.target) for fault in done] == [
        (Kind.COORDINATOR_KILLED, "coordinator"),
        (Kind.WORKER_KILLED, "worker-1"),
    ]
    for name in ("coordinator", "worker-1"):
        assert sleepers[name].wait(10.0) == -signal.SIGKILL
    assert sleepers["worker-0"].poll() is None


def test_while_no_worker_tracks_anything_neither_is_killed(
    sleepers: dict[str, subprocess.Popen[bytes]],
) -> None:
    tested = injector(sleepers, [])
    assert tested.tick(AT_NS) == []
    assert tested.skipped == []
    assert tested.tick(AT_NS + int(TRY_FOR_S * 1e9)) == []
    assert tested.skipped == [BOTH]
    assert all(process.poll() is None for process in sleepers.values())
