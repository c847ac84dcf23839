import math

import msgspec
import pytest

from clustermcl.coordinator import events
from clustermcl.coordinator.checkpoint import STATE_VERSION, CheckpointState, from_bytes, to_bytes
from clustermcl.coordinator.state import CoordinatorState
from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.filter.settings import FilterSettings
from clustermcl.protocol.work import Checkpoint, ElsewhereJob, WorkerState
from clustermcl.runtime.settings import BridgeSettings, CoordinatorSettings
from tests.unit.coordinator.living import Living
from tests.unit.coordinator.reports import checkpoint, literal_bayes, scan, started

NOTHING = WorkerState(sender="w", term=0, holds=())


@pytest.fixture(scope="module")
def state(model: SensorModel) -> CheckpointState:
    living = Living(model).drive_on(10)
    return from_bytes(living.kept.state)


def changed(state: CheckpointState, **changes: object) -> bytes:
    """Encode the state after changes; a name is the path of a field, with __ for each dot."""
    tree = msgspec.msgpack.decode(to_bytes(state))
    for path, value in changes.items():
        *owners, name = path.split("__")
        part = tree
        for owner in owners:
            part = part[owner]
        part[name] = value
    return msgspec.msgpack.encode(tree)


def test_a_decoded_state_equals_the_encoded_one(state: CheckpointState) -> None:
    assert to_bytes(from_bytes(to_bytes(state))) == to_bytes(state)
    assert len(state.ensemble.clusters) > 1


def test_a_state_is_small_once_workers_keep_the_particles(model: SensorModel) -> None:
    """A job that no worker has confirmed carries its first particles."""
    state = from_bytes(Living(model).drive_on(16).kept.state)
    tracks = {job_id: job.job for job_id, job in state.jobs.placed.items() if job_id[0] in "cd"}
    assert {job_id[0] for job_id in tracks} == {"c", "d"}
    assert set(tracks.values()) == {None}
    small = changed(state, event_log__kept=[], ensemble__pieces__rows=b"")
    assert len(small) < 4_000, "but for its last 50 events and the pieces of wall"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"version": STATE_VERSION + 1}, f"expected {STATE_VERSION}"),
        ({"ensemble__clusters__log_elsewhere": math.nan}, "log_elsewhere"),
        ({"ensemble__clusters__short": 2.0}, "short"),
        ({"ensemble__clusters__fit__variance": 0.0}, "variance"),
        ({"ensemble__search__gathered": 1.0}, "gathered"),
        ({"ensemble__search__means": {}}, "no coordinator has written"),
        ({"collector__applied__odom_from_robot": [math.nan, 0.0, 0.0]}, "odom_from_robot"),
        ({"collector__applied__step": 2**62}, "step"),
        ({"age_s": math.inf}, "age_s"),
        ({"reports_missing": 2**52}, "reports_missing"),
        ({"counters": {"report late": 2**53 - 1}}, "counters"),
    ],
)
def test_a_state_that_cannot_be_used_is_refused_with_the_reason(
    state: CheckpointState, changes: dict[str, object], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        from_bytes(changed(state, **changes))


@pytest.mark.parametrize("data", [b"", b"rubbish", b"\x80", None])
def test_a_checkpoint_that_is_of_no_use_is_counted_and_the_search_begins(
    state: CheckpointState, data: bytes | None
) -> None:
    of_other_map = changed(state, map_digest="old")
    broken = checkpoint(5, state=of_other_map if data is None else data)
    made = started(known=broken).coordinator()
    made.handle(events.WorkerChanged("w", "joined"), 0)
    made.handle(events.ScanArrived(scan(40)), 1)
    done = made.handle(events.WorkerStateArrived("w", NOTHING), 2)
    assert made.term.begun
    (handed_on,) = (i for i in done if isinstance(i, Checkpoint))
    assert handed_on.term > broken.term
    why = "that cannot be read" if data is not None else "of another map"
    assert made.status(3, {}).counters == {f"checkpoint {why}": 1}
    assert made.status(3, {}).clusters == 0


@pytest.mark.parametrize("had", [True, False], ids=["the same settings", "other settings"])
def test_a_successor_begins_the_elsewhere_job_that_its_predecessor_lacked(
    state: CheckpointState, had: bool
) -> None:
    placed = msgspec.msgpack.decode(to_bytes(state))["jobs"]["placed"]
    jobs = {job_id: job for job_id, job in placed.items() if had or job_id != "e0"}
    known = checkpoint(5, state=changed(state, jobs__placed=jobs))
    made = CoordinatorState.of("c", FilterSettings(), CoordinatorSettings(), BridgeSettings())
    assert made.resume(known, 1) == 10
    assert made.placement.jobs.placed["e0"].job == ElsewhereJob(first_step=10)
    never = FilterSettings(belief=literal_bayes())
    other = CoordinatorState.of("c", never, CoordinatorSettings(), BridgeSettings())
    assert other.resume(known, 1) == 10
    assert ("e0" in other.placement.jobs.placed) == had
