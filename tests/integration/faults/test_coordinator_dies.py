"""docs/failures.md: coordinator, router or all die: the next one has the same belief."""

import math
import os
import signal
import time
from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace

from clustermcl.commands.stack import COORDINATOR, ROUTER, WORKERS
from clustermcl.coordinator import state_file
from clustermcl.coordinator.checkpoint import state_in
from clustermcl.coordinator.recovery import LastPlace
from clustermcl.filter.settings import BeliefSettings
from clustermcl.link.wire import alive, ask
from clustermcl.protocol import keys
from clustermcl.protocol.answers import PoseAnswer
from clustermcl.protocol.codec import encode
from clustermcl.protocol.errors import UnreachableError
from clustermcl.protocol.job_events import Began
from clustermcl.protocol.work import Checkpoint
from clustermcl.runtime.settings import BridgeSettings, CoordinatorSettings, Settings
from tests.integration.alone import assert_same, outcomes_of
from tests.integration.faults.live_robot import assert_same_as_alone, with_live_robot
from tests.integration.faults.system import IMPATIENT, SIMULATOR, SMALL, System, system
from tests.integration.waiting import stretched_s, wait_until

LEASE_S = 2.0
"""After this time of silence the router closes a link."""
STEPS = 45
LOCKSTEP = replace(
    SMALL,
    belief=BeliefSettings(max_clusters=6, search_every_steps=12),
    bridge=BridgeSettings(source="sim:cross_feature", rate=0.0),
)
"""As fast as the workers follow, with searches and candidates all along."""


def test_a_coordinator_killed_while_searching_and_tracking_changes_no_belief() -> None:
    alone = outcomes_of(LOCKSTEP, steps=STEPS)
    with system(LOCKSTEP, "--steps", str(STEPS)) as tested:
        for step in (3, 15, 16, 32):
            wait_until(lambda s=step: tested.step >= s)  # type: ignore[misc] # a default
            tested.restart(COORDINATOR)
        tested.wait_for_the_end()
        assert len({belief.term for belief in tested.beliefs}) >= 4, "it was several coordinators"
        assert_same(tested.beliefs, alone)
        assert tested.status().steps_lost == 0


def test_a_restarted_coordinator_and_then_a_standby_follow_a_robot_that_drives_on() -> None:
    """Steps without a coordinator are applied later from the workers' reports.

    A new coordinator answers once it knows the age of the robot's data. The last checkpoint that
    the standby receives is poisoned: it uses its state file. A stray token is of no worker.
    """
    with with_live_robot() as (tested, robot):
        tested.wait_until_it_tracks()
        stray = tested.session.liveliness().declare_token(keys.worker_alive("no.name"))
        before, workers, term = tested.step, tested.worker_pids(), tested.beliefs[-1].term
        robot.send_signal(signal.SIGSTOP)
        tested.restart(COORDINATOR)
        time.sleep(1.5)
        wait_until(lambda: alive(tested.session, keys.COORDINATOR_ALIVE, 1.0))
        with pytest.raises(UnreachableError):  # it does not know yet how old the robot's data are
            ask(tested.session, keys.POSE, PoseAnswer, timeout_s=1.0)
        robot.send_signal(signal.SIGCONT)
        assert tested.pose().freshness == "fresh"
        follows_within_two_seconds(tested, term)
        second = tested.start(COORDINATOR)
        assert second.wait() == 2
        assert "already has a coordinator" in second.err
        assert "--standby" in second.err
        standby = tested.start(COORDINATOR, "--standby")
        standby.wait_for("standing by")
        newest = tested.next_message(keys.CHECKPOINT, Checkpoint, has_clusters)
        tested.session.put(keys.CHECKPOINT, encode(poisoned(newest)))
        term = tested.beliefs[-1].term
        tested.hurt(COORDINATOR)
        follows_within_two_seconds(tested, term)
        steps = [belief.step for belief in tested.since(before)]
        assert sorted(set(steps)) == list(range(before + 1, steps[-1] + 1)), "none was left out"
        assert tested.worker_pids() == workers
        status = tested.status()
        assert status.counters["checkpoint that cannot be read"] >= 1
        assert status.steps_lost == 0
        assert_same_as_alone(tested)
        assert "Traceback" not in standby.err
        stray.undeclare()
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
        began = [event for event in tested.events(before) if isinstance(event, Began)]
        assert "first search" not in {event.cause for event in began}


def follows_within_two_seconds(tested: System, term: int) -> None:
    begun_s = time.monotonic()
    wait_until(lambda: tested.beliefs[-1].term > term)
    assert time.monotonic() - begun_s < stretched_s(2.0)
    tested.wait_for_steps(10)


def has_clusters(checkpoint: Checkpoint) -> bool:
    return len(state_in(checkpoint).ensemble.clusters) > 0


def poisoned(checkpoint: Checkpoint) -> Checkpoint:
    """Return the same with a NaN in it, and of a rank above all present ones."""
    tree = msgspec.msgpack.decode(checkpoint.state)
    cluster = next(iter(tree["ensemble"]["clusters"]["clusters"].values()))
    cluster["covariance"] = [math.nan] * 9
    state = msgspec.msgpack.encode(tree)
    return replace(checkpoint, sender="an intruder", serial=2**50, state=state)


def test_a_coordinator_frozen_until_its_link_expires_gets_the_lost_reports() -> None:
    with with_live_robot(IMPATIENT) as (tested, _robot):
        tested.wait_until_it_tracks()
        before, pid = tested.step, tested.pid(COORDINATOR)
        os.kill(pid, signal.SIGSTOP)
        time.sleep(LEASE_S + 0.5)
        os.kill(pid, signal.SIGCONT)
        wait_until(lambda: "the link to the router is back" in tested.log(COORDINATOR))
        tested.wait_for_steps(60)
        later = tested.since(before)
        assert [one.step for one in later] == list(range(before + 1, later[-1].step + 1))
        everyone = {f"c{place.cluster}" for place in later[0].hypotheses}
        unweighed = [one.step for one in later if everyone <= set(one.missing)]
        assert not unweighed, "a slow worker may miss a step, but not all"


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
        assert_same_as_alone(tested)
        standby.kill()  # and now it is its turn again
        highest = max(terms)
        wait_until(lambda: tested.beliefs[-1].term > highest)
        tested.wait_for_steps(10)
        assert_same_as_alone(tested)


OUTAGE_S = 2.5
"""Longer than the lease of 2 s."""


def test_a_restart_of_the_router_loses_only_the_steps_made_meanwhile() -> None:
    with system() as tested:
        tested.wait_until_it_tracks()
        placed, clusters = tested.jobs(), tested.clusters()
        pids, workers = dict(tested.stack.supervisor.pids()), tested.worker_pids()
        tested.hurt(ROUTER)
        time.sleep(OUTAGE_S)
        last_before = tested.step
        tested.mend()
        mended_s = time.monotonic()
        wait_until(lambda: tested.step > last_before)
        assert time.monotonic() - mended_s < stretched_s(2.5), "to connect, and to decide"
        tested.wait_for_steps(10)
        assert tested.clusters() == clusters
        assert tested.jobs() == placed, "no cluster was moved"
        assert tested.worker_pids() == workers
        for name in (COORDINATOR, WORKERS, SIMULATOR):
            assert tested.pid(name) == pids[name], f"{name} went on"
        # The simulated robot waits for a coordinator, so even the steps of the outage are there.
        after = tested.since(last_before)
        assert [belief.missing for belief in after] == [()] * len(after)
        assert tested.status().steps_lost == 0


def kept_in(folder: Path) -> Settings:
    return replace(
        SMALL,
        bridge=BridgeSettings(source="sim:cross_feature", rate=0.0),
        coordinator=CoordinatorSettings(lockstep_deadline_s=60.0, state_folder=str(folder)),
    )


def test_after_a_power_cut_the_place_in_the_state_file_is_one_hypothesis(tmp_path: Path) -> None:
    with system(kept_in(tmp_path), "--steps", "400") as tested:
        wait_until(lambda: any(b.state == "localized" for b in tested.beliefs))
        tested.wait_for_steps(5)
        for name in tested.stack.supervisor.pids():
            tested.hurt(name)
        reported = {belief.step: belief for belief in tested.beliefs}
        kept = state_file.read(tmp_path, "robot")
        assert kept is not None
        state = state_in(kept)
        assert state.collector.applied is not None
        step = state.collector.applied.step
        assert abs(step - max(reported)) < 10, "one of the newest; some were still on their way"
        place = LastPlace.of(state)
        assert place is not None
        if step in reported:
            assert place.pose == reported[step].hypotheses[0].pose
    with system(kept_in(tmp_path), "--steps", "40") as tested:
        wait_until(lambda: any(b.state != "searching" for b in tested.beliefs))
        first = next(b for b in tested.beliefs if b.state != "searching")
        assert first.step < step, "another life, with a search of its own"
        assert all(h.age_steps <= first.step for h in first.hypotheses)
