"""Faults, done to real processes that only sleep."""

import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence

import psutil
import pytest

from tests.soak.fleet import COORDINATOR, WORKER, Part
from tests.soak.injector import TRY_FOR_S, Injector, Targets
from tests.soak.schedule import Fault, Kind

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


class Cables:
    """Records what is cut."""

    def __init__(self) -> None:
        self.set: list[tuple[set[int], bool, bool]] = []

    def __call__(self, pids: Sequence[int], *, to_router: bool, from_router: bool) -> None:
        self.set.append((set(pids), to_router, from_router))


def injector(
    sleepers: dict[str, subprocess.Popen[bytes]],
    trackers: list[str],
    *faults: Fault,
    cables: Cables | None = None,
) -> Injector:
    parts = [
        Part("r", role, f"r/{name}", psutil.Process(sleepers[name].pid))
        for role, name in (
            (COORDINATOR, "coordinator"), (WORKER, "worker-0"), (WORKER, "worker-1")
        )
    ]  # fmt: skip
    targets = Targets(
        parts=lambda: parts,
        trackers=lambda _: trackers,
        leader=lambda: "coordinator",
        seen={},
        set_cables=cables or Cables(),
        publish=lambda _key, _payload: None,
        query=lambda _key, _payload: None,
    )
    return Injector(faults, targets)


def test_a_worker_and_the_coordinator_are_killed_together_and_listed_one_by_one(
    sleepers: dict[str, subprocess.Popen[bytes]],
) -> None:
    done = injector(sleepers, ["worker-1"], BOTH).tick(AT_NS, 0)
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
    tracking = list[str]()
    tested = injector(sleepers, tracking, BOTH)
    assert tested.tick(AT_NS, 0) == []
    assert tested.tick(AT_NS + int(TRY_FOR_S * 1e9), 0) == []
    tracking.append("worker-1")
    assert tested.tick(AT_NS + int(TRY_FOR_S * 1e9) + 1, 0) == [], "it is skipped"
    assert all(process.poll() is None for process in sleepers.values())


@pytest.mark.parametrize(
    ("choice", "worker", "to_router", "from_router"),
    [(0.1, "worker-0", False, False), (0.3, "worker-1", False, False),
     (0.4, "worker-0", False, True), (0.9, "worker-1", True, False)],
)  # fmt: skip
def test_every_other_worker_is_cut_off_both_ways_or_one_and_then_no_more(
    sleepers: dict[str, subprocess.Popen[bytes]],
    choice: float,
    worker: str,
    to_router: bool,
    from_router: bool,
) -> None:
    cables, pids = Cables(), {sleepers[worker].pid}
    fault = Fault(at_s=1.0, kind=Kind.WORKER_LINKS_CUT, lasts_s=20.0, choice=choice)
    tested = injector(sleepers, [], fault, cables=cables)
    done = tested.tick(AT_NS, 0)
    assert [(one.target, one.until_ns) for one in done] == [(worker, 21 * AT_NS)]
    assert cables.set == [(pids, to_router, from_router)]
    tested.tick(20 * AT_NS, 0)
    assert len(cables.set) == 1
    tested.tick(21 * AT_NS, 0)
    assert cables.set[1:] == [(pids, True, True)]


def test_what_is_cut_in_the_end_is_mended_and_all_workers_are_never_cut_off_at_once(
    sleepers: dict[str, subprocess.Popen[bytes]],
) -> None:
    cables = Cables()
    coordinator, worker = ({sleepers[name].pid} for name in ("coordinator", "worker-0"))
    faults = [
        Fault(at_s=1.0, kind=kind, lasts_s=lasts_s, choice=choice)
        for kind, lasts_s, choice in (
            (Kind.COORDINATOR_LINK_CUT, 5.0, 0.0),
            (Kind.WORKER_LINKS_CUT, 60.0, 0.0),
            (Kind.WORKER_LINKS_CUT, 60.0, 0.3),
        )
    ]
    tested = injector(sleepers, [], *faults, cables=cables)
    assert [fault.target for fault in tested.tick(AT_NS, 0)] == ["coordinator", "worker-0"]
    assert cables.set == [(coordinator, False, False), (worker, False, False)]
    assert tested.tick(6 * AT_NS, 0) == []
    assert cables.set[2:] == [(coordinator, True, True)]
    tested.end_all()
    tested.end_all()
    assert cables.set[3:] == [(worker, True, True)]
