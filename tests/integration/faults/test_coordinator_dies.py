"""docs/failures.md: the coordinator dies: a new one carries on with the same belief."""

import math
import os
import signal
import time
from collections.abc import Sequence

import msgspec

from clustermcl.stack import COORDINATOR, WORKERS
from coordinator.belief.outcome import Outcome
from coordinator.checkpoint import state_in
from coordinator.process import filter_settings
from evaluation.in_process import outcomes
from particle_filter.settings import BeliefSettings
from process_runtime.settings import BridgeSettings, Settings
from protocol import keys
from protocol.answers import Belief
from protocol.codec import decode, encode
from protocol.job_events import Began
from protocol.steps import ScanHistory
from protocol.work import Checkpoint
from robot_simulator.worlds.catalogue import world
from tests.integration.faults.live_robot import WORLD, with_live_robot
from tests.integration.faults.system import SMALL, System, system
from tests.integration.system.listening import outcomes_of
from tests.integration.waiting import PATIENCE_S, stretched_s, wait_until
from worker.map_model import sensor_model
from zenoh_link.wire import ask

STEPS = 45
LOCKSTEP = msgspec.structs.replace(
    SMALL,
    belief=BeliefSettings(max_clusters=6, search_every_steps=12),
    bridge=BridgeSettings(source="sim:cross_feature", rate=0.0),
)
"""As fast as the workers follow, with searches and candidates all along."""


def assert_same(beliefs: Sequence[Belief], alone: Sequence[Outcome]) -> None:
    """Every received belief, repeated ones included, equals that of one process."""
    expected = {outcome.step: outcome for outcome in alone}
    for belief in beliefs:
        assert belief.missing == (), f"step {belief.step}"
        assert belief.hypotheses == expected[belief.step].hypotheses, f"step {belief.step}"
        assert belief.state == expected[belief.step].state, f"step {belief.step}"
        assert belief.searching == expected[belief.step].searching, f"step {belief.step}"


def alone_of(tested: System, settings: Settings = SMALL) -> list[Outcome]:
    history = ask(tested.session, keys.scan_history(0, None), ScanHistory, timeout_s=PATIENCE_S)
    assert history.scans[0].step == 0
    grid_map = world(WORLD).map
    model = sensor_model(grid_map, settings.sensor, cache_folder=None)
    plain = filter_settings(settings)
    return [outcome for _, outcome in outcomes(history.scans, model, plain)]


def test_a_coordinator_killed_while_searching_and_tracking_changes_no_belief() -> None:
    alone = outcomes_of(LOCKSTEP, steps=STEPS)
    with system(LOCKSTEP, "--steps", str(STEPS)) as tested:
        for step in (3, 15, 16, 32):
            wait_until(lambda s=step: tested.step >= s)  # type: ignore[misc] # a default
            tested.restart(COORDINATOR)
        wait_until(lambda: bool(tested.beliefs) and tested.beliefs[-1].last)
        assert len({belief.term for belief in tested.beliefs}) >= 4, "it was several coordinators"
        assert_same(tested.beliefs, alone)
        with tested.client as client:
            assert client.status().steps_lost == 0


def test_a_restarted_coordinator_and_then_a_standby_follow_a_robot_that_drives_on() -> None:
    """Steps without a coordinator are applied later from the workers' reports.

    The last checkpoint that the standby receives is poisoned: it uses its state file.
    """
    with with_live_robot() as (tested, _robot):
        tested.wait_until_it_tracks()
        before, workers = tested.step, tested.worker_pids()
        tested.restart(COORDINATOR)
        follows_within_two_seconds(tested)
        second = tested.start(COORDINATOR)
        assert second.wait() == 2
        assert "already has a coordinator" in second.err
        assert "--standby" in second.err
        standby = tested.start(COORDINATOR, "--standby")
        standby.wait_for("standing by")
        tested.session.put(keys.CHECKPOINT, encode(poisoned(newest_checkpoint(tested))))
        tested.hurt(COORDINATOR)
        follows_within_two_seconds(tested)
        steps = [belief.step for belief in tested.since(before)]
        assert sorted(set(steps)) == list(range(before + 1, steps[-1] + 1)), "none was left out"
        assert tested.worker_pids() == workers
        with tested.client as client:
            status = client.status()
        assert status.counters["checkpoint that cannot be read"] >= 1
        assert status.steps_lost == 0
        assert_same(list(tested.beliefs), alone_of(tested))
        assert "Traceback" not in standby.err
        standby.send_signal(signal.SIGTERM)
        assert standby.wait() == 0


def test_workers_and_coordinator_killed_together_lose_no_place() -> None:
    """The bridge still has the last scan of the state file, so the robot is not searched for."""
    with with_live_robot() as (tested, _robot):
        tested.wait_until_it_tracks()
        before, term, places = tested.step, tested.beliefs[-1].term, tested.clusters()
        for pid in (*tested.worker_pids(), tested.pid(WORKERS)):
            os.kill(pid, signal.SIGKILL)
        tested.restart(COORDINATOR)
        wait_until(lambda: tested.tracks() and tested.beliefs[-1].term > term)
        later = tested.since(before)
        assert all(belief.hypotheses for belief in later), "no step without a place"
        assert tested.clusters() & places
        with tested.client as client:
            causes = {
                one.event.cause for one in client.events().events if isinstance(one.event, Began)
            }
        assert "first search" not in causes


def follows_within_two_seconds(tested: System) -> None:
    """Wait for beliefs of another coordinator than that of the last belief."""
    begun_s, terms = time.monotonic(), {belief.term for belief in tested.beliefs}
    wait_until(lambda: {belief.term for belief in tested.beliefs} > terms)
    assert time.monotonic() - begun_s < stretched_s(2.0)
    tested.wait_for_steps(10)


def newest_checkpoint(tested: System) -> Checkpoint:
    """Return a checkpoint of the acting coordinator, with clusters that are tracked."""
    found: list[Checkpoint] = []
    subscriber = tested.session.declare_subscriber(
        keys.CHECKPOINT, lambda sample: found.append(decode(sample.payload.to_bytes(), Checkpoint))
    )
    wait_until(lambda: found and len(state_in(found[-1]).ensemble.clusters))
    subscriber.undeclare()
    return found[-1]


def poisoned(checkpoint: Checkpoint) -> Checkpoint:
    """Return the same with a NaN in it, and of a rank above all present ones."""
    tree = msgspec.msgpack.decode(checkpoint.state)
    cluster = next(iter(tree["ensemble"]["clusters"]["clusters"].values()))
    cluster["covariance"] = [math.nan] * 9
    state = msgspec.msgpack.encode(tree)
    return msgspec.structs.replace(checkpoint, sender="an intruder", serial=2**50, state=state)


def test_a_frozen_coordinator_steps_down_and_never_acts_next_to_its_successor() -> None:
    with with_live_robot() as (tested, _robot):
        standby = tested.start(COORDINATOR, "--standby")
        standby.wait_for("standing by")
        tested.wait_until_it_tracks()
        frozen, before = tested.pid(COORDINATOR), tested.beliefs[-1].term
        os.kill(frozen, signal.SIGSTOP)
        standby.wait_for("taking over")
        wait_until(lambda: tested.beliefs[-1].term > before)
        os.kill(frozen, signal.SIGCONT)
        wait_until(lambda: "stepping down" in tested.log(COORDINATOR))
        wait_until(lambda: tested.log(COORDINATOR).count("standing by") == 1)
        tested.wait_for_steps(10)
        terms = [belief.term for belief in tested.beliefs]
        assert terms == sorted(terms), "no belief of the old one after the first of the new one"
        assert_same(list(tested.beliefs), alone_of(tested))
        standby.kill()  # and now it is its turn again
        highest = max(terms)
        wait_until(lambda: tested.beliefs[-1].term > highest)
        tested.wait_for_steps(10)
        assert_same(list(tested.beliefs), alone_of(tested))
