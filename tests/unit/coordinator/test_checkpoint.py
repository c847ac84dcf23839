import math
import subprocess
import sys

import msgspec
import pytest

from coordinator.belief.ensemble import EnsembleState
from coordinator.checkpoint import (
    STATE_VERSION,
    CheckpointState,
    ImpossibleStateError,
    from_bytes,
    to_bytes,
)
from coordinator.coordinator import Coordinator
from coordinator.events import ScanArrived, WorkerJoined, WorkerToldState
from coordinator.instructions import PublishCheckpoint
from coordinator.recovery import WorkerSnapshot
from coordinator.state import CoordinatorState
from coordinator.step_collector import StepCollectorState
from particle_filter.evidence_model import UsualFit
from particle_filter.off_map import MapQuality
from particle_filter.settings import FilterSettings
from particle_filter.view_memory import ViewMemory
from process_runtime.settings import BridgeSettings, CoordinatorSettings
from protocol.work import Checkpoint, ElsewhereJob
from tests.unit.coordinator.living import Living, symmetric_room
from tests.unit.coordinator.reports import literal_bayes, scan

NOTHING = WorkerSnapshot(term=0)


@pytest.fixture(scope="module")
def state() -> CheckpointState:
    """Of a coordinator that tracks several clusters."""
    living = Living(symmetric_room())
    for step in range(10):
        living.drive(step)
    assert living.kept is not None
    return from_bytes(living.kept.state)


def changed(state: CheckpointState, **fields: object) -> bytes:
    return to_bytes(msgspec.structs.replace(state, **fields))


def gathering(state: CheckpointState, **evidence: object) -> EnsembleState:
    """The belief, and other things that it has gathered while it searched."""
    search = state.ensemble.search
    assert search is not None
    told = msgspec.structs.replace(search.evidence, **evidence)
    return msgspec.structs.replace(
        state.ensemble, search=msgspec.structs.replace(search, evidence=told)
    )


def test_a_state_comes_back_as_it_was(state: CheckpointState) -> None:
    assert from_bytes(to_bytes(state)) == state
    assert len(state.ensemble.clusters) > 1


def test_it_is_small_for_particles_stay_with_the_workers(state: CheckpointState) -> None:
    assert all(job.job is None for job in state.jobs if job.job_id.startswith("c"))
    assert len(to_bytes(state)) < 4_000


def test_states_that_cannot_be_used_are_refused_with_the_reason(state: CheckpointState) -> None:
    replace = msgspec.structs.replace
    lost = replace(state.ensemble, clusters=(), log_elsewhere=0.0, log_off_map=-math.inf)
    blind = MapQuality(crude=math.nan)
    first, *rest = state.ensemble.clusters
    poisoned = replace(state.ensemble, clusters=(replace(first, log_probability=math.nan), *rest))
    assert ElsewhereJob in {type(job.job) for job in state.jobs}
    misnamed = [replace(job, job_id="e1") if job.job_id == "e0" else job for job in state.jobs]
    for data, words in (
        (b"", "not a coordinator's state"),
        (b"\xc1", "not a coordinator's state"),
        (to_bytes(state)[:-3], "not a coordinator's state"),
        (changed(state, version=STATE_VERSION + 1), f"expected {STATE_VERSION}"),
        (changed(state, ensemble=lost), "no cluster"),
        (changed(state, collector=StepCollectorState(applied=None, steps_lost=0)), "no cluster"),
        (changed(state, ensemble=poisoned), "probability"),
        (changed(state, ensemble=replace(state.ensemble, log_elsewhere=math.nan)), "elsewhere"),
        (changed(state, ensemble=replace(state.ensemble, log_elsewhere=0.0)), "sum to one"),
        (changed(state, ensemble=replace(state.ensemble, log_off_map=0.0)), "sum to one"),
        (changed(state, ensemble=replace(state.ensemble, quality=blind)), "Quality"),
        (changed(state, ensemble=replace(state.ensemble, quality=MapQuality(short=2.0))), "short"),
        (changed(state, ensemble=replace(state.ensemble, fit=UsualFit(math.inf))), "usual fit"),
        (changed(state, ensemble=replace(state.ensemble, fit=UsualFit(variance=0.0))), "usual fit"),
        (changed(state, ensemble=replace(state.ensemble, seen=ViewMemory(b"x"))), "of views"),
        (changed(state, ensemble=gathering(state, log_elsewhere=math.nan)), "elsewhere"),
        (changed(state, ensemble=gathering(state, log_elsewhere=math.inf)), "elsewhere"),
        (changed(state, ensemble=gathering(state, gathered={3: math.nan})), "log-likelihood"),
        (changed(state, ensemble=gathering(state, gathered={-3: 1.0})), "step"),
        (
            changed(state, ensemble=gathering(state, gathered=dict.fromkeys(range(3000), 1.0))),
            "of one kind",
        ),
        (changed(state, jobs=tuple(misnamed)), "no cluster"),
    ):
        with pytest.raises(ValueError, match=words):
            from_bytes(data)


def test_a_count_without_room_to_count_on_is_refused(state: CheckpointState) -> None:
    """It was carried on from, and the coordinator's own next checkpoint could not be read."""
    assert from_bytes(changed(state, reports_missing=2**52 - 1)).reports_missing
    for full in ({"reports_missing": 2**52}, {"counters": {"report late": 2**53 - 1}}):
        with pytest.raises(ImpossibleStateError, match="no room to count on"):
            from_bytes(changed(state, **full))


@pytest.mark.parametrize("data", [b"", b"rubbish", b"\x80"])
def test_a_checkpoint_that_cannot_be_read_is_counted_and_the_search_begins(data: bytes) -> None:
    broken = Checkpoint(sender="c", term=5, serial=1, step=9, founded=True, state=data)
    made = Coordinator("c", FilterSettings(), CoordinatorSettings(), "test", 0, known=broken)
    made.handle(WorkerJoined("w"), 0)
    made.handle(WorkerToldState("w", NOTHING), 1)
    assert made.begun
    done = made.handle(ScanArrived(scan(0)), 2)
    (handed_on,) = (i for i in done if isinstance(i, PublishCheckpoint))
    assert handed_on.checkpoint.term > broken.term
    assert made.status(3, {}).counters == {"checkpoint that cannot be read": 1}


def test_a_checkpoint_of_another_map_is_not_carried_on(state: CheckpointState) -> None:
    other = Checkpoint(
        sender="c", term=5, serial=1, step=9, founded=True, state=changed(state, map_digest="old")
    )
    made = Coordinator("c", FilterSettings(), CoordinatorSettings(), "test", 0, known=other)
    made.handle(WorkerJoined("w"), 0)
    made.handle(ScanArrived(scan(40)), 1)
    made.handle(WorkerToldState("w", NOTHING), 2)
    assert made.status(3, {}).counters == {"checkpoint of another map": 1}
    assert made.status(3, {}).clusters == 0


@pytest.mark.parametrize("had", [True, False], ids=["the same settings", "other settings"])
def test_who_carries_on_has_scans_weighed_elsewhere_also_if_nobody_did(
    state: CheckpointState, had: bool
) -> None:
    jobs = tuple(job for job in state.jobs if had or job.job_id != "e0")
    known = Checkpoint(
        sender="c", term=5, serial=1, step=9, founded=True, state=changed(state, jobs=jobs)
    )
    made = CoordinatorState("c", FilterSettings(), CoordinatorSettings(), BridgeSettings())
    assert made.resume(known, 1) == 10
    (elsewhere,) = (job for job in made.placement.state() if job.job_id == "e0")
    assert elsewhere.job == ElsewhereJob(first_step=10)
    never = FilterSettings(belief=literal_bayes())
    other = CoordinatorState("c", never, CoordinatorSettings(), BridgeSettings())
    assert other.resume(known, 1) == 10
    assert ("e0" in {job.job_id for job in other.placement.state()}) == had


MANY_AT_ONCE = """
import os, sys, threading
from coordinator.checkpoint import from_bytes

sys.setswitchinterval(1e-6)
data, together = sys.stdin.buffer.read(), threading.Barrier(6)


def read():
    together.wait()
    from_bytes(data)


for _ in range(12):  # processes that have read none so far
    if not (child := os.fork()):
        threads = [threading.Thread(target=read) for _ in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        os._exit(0)
    if os.waitpid(child, 0)[1]:
        sys.exit("crashed")
"""


def test_threads_may_read_the_first_state_at_the_same_time(state: CheckpointState) -> None:
    """As do the loop and the flight recorder of a coordinator that takes over."""
    command = [sys.executable, "-c", MANY_AT_ONCE]
    ended = subprocess.run(
        command, input=to_bytes(state), check=False, capture_output=True, timeout=120
    )
    assert ended.returncode == 0, ended.stderr.decode()
