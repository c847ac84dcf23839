"""docs/failures.md: the coordinator dies: a new one carries on with the same belief."""

import os
import signal
import time
from collections.abc import Sequence

import msgspec

from clustermcl.stack import COORDINATOR
from coordinator.belief.outcome import Outcome
from coordinator.process import filter_settings
from evaluation.in_process import outcomes
from particle_filter.settings import BeliefSettings
from process_runtime.settings import BridgeSettings, Settings
from protocol import keys
from protocol.answers import Belief
from protocol.steps import ScanHistory
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
    """The beliefs of one process after the bridge's steps up to now."""
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


def test_a_robot_that_drives_on_is_followed_again_within_two_seconds() -> None:
    """Steps without a coordinator are applied later from the workers' reports."""
    with with_live_robot() as (tested, _robot):
        tested.wait_until_it_tracks()
        before, workers = tested.step, tested.worker_pids()
        tested.restart(COORDINATOR)
        started_s = time.monotonic()
        wait_until(lambda: len({belief.term for belief in tested.beliefs}) == 2)
        assert time.monotonic() - started_s < stretched_s(2.0)
        tested.wait_for_steps(10)
        steps = [belief.step for belief in tested.since(before)]
        assert sorted(set(steps)) == list(range(before + 1, steps[-1] + 1)), "none was left out"
        assert tested.worker_pids() == workers
        with tested.client as client:
            assert client.status().steps_lost == 0
        assert_same(list(tested.beliefs), alone_of(tested))


def test_a_standby_takes_over_at_once_and_a_second_coordinator_refuses_to_start() -> None:
    with with_live_robot() as (tested, _robot):
        standby, second = tested.start(COORDINATOR, "--standby"), tested.start(COORDINATOR)
        standby.wait_for("standing by")
        tested.wait_until_it_tracks()
        assert second.wait() == 2
        assert "already has a coordinator" in second.err
        assert "--standby" in second.err
        terms = {belief.term for belief in tested.beliefs}
        tested.hurt(COORDINATOR)
        killed_s = time.monotonic()
        wait_until(lambda: {belief.term for belief in tested.beliefs} > terms)
        assert time.monotonic() - killed_s < stretched_s(2.0)
        tested.wait_for_steps(10)
        with tested.client as client:
            assert client.status().steps_lost == 0
        assert_same(list(tested.beliefs), alone_of(tested))
        standby.send_signal(signal.SIGTERM)
        assert standby.wait() == 0


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
