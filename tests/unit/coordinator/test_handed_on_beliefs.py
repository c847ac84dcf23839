"""A coordinator that dies at any moment changes no belief."""

import hypothesis
import pytest
from hypothesis import strategies as st

from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.protocol.answers import Belief, SetPose
from clustermcl.protocol.live_settings import LiveSettings
from clustermcl.protocol.message import MAX_SCAN_STEP
from clustermcl.protocol.step_reset_detector import HUGE_JUMP
from tests.unit.coordinator.living import Living

STEPS = 26


@pytest.fixture(scope="module")
def undisturbed(model: SensorModel) -> Living:
    return Living(model).drive_on(STEPS)


def essence(belief: Belief) -> tuple[object, ...]:
    """All of a belief but the term."""
    return (
        belief.state, belief.hypotheses, belief.elsewhere_probability, belief.searching,
        belief.missing,
    )  # fmt: skip


def assert_same(living: Living, undisturbed: Living) -> None:
    for step in range(STEPS):
        (expected,) = map(essence, undisturbed.beliefs[step])
        believed = living.beliefs[step]
        assert all(essence(belief) == expected for belief in believed), f"step {step}"
    assert living.particles() == undisturbed.particles()


def test_the_undisturbed_run_has_clusters_searches_and_commands(undisturbed: Living) -> None:
    beliefs = [undisturbed.beliefs[step][0] for step in range(STEPS)]
    assert max(len(belief.hypotheses) for belief in beliefs) >= 3
    assert beliefs[0].searching
    assert any(belief.searching and belief.state != "searching" for belief in beliefs)
    assert all(belief.missing == () for belief in beliefs)
    assert undisturbed.warnings == []
    assert len({h.cluster for belief in beliefs for h in belief.hypotheses}) > 5, "candidates"


@hypothesis.settings(deadline=None, max_examples=12)
@hypothesis.given(
    dies_at=st.integers(1, STEPS - 2), after=st.integers(0, 12), away=st.integers(0, 5)
)
def test_a_coordinator_that_dies_between_any_two_instructions_changes_no_belief(
    model: SensorModel, undisturbed: Living, dies_at: int, after: int, away: int
) -> None:
    living = Living(model)
    for step in range(STEPS):
        if step == dies_at:
            living.dies_in = after
        if living.coordinator is None and step > dies_at + away:
            living.revive()
        living.drive(step)
    living.dies_in = None
    if living.coordinator is None:
        living.revive()
    assert_same(living, undisturbed)


def test_a_worker_that_dies_leaves_its_clusters_to_others_particle_by_particle(
    model: SensorModel, undisturbed: Living
) -> None:
    living = Living(model).drive_on(17)
    living.kill_worker("w1")
    assert_same(living.drive_on(STEPS), undisturbed)


@pytest.mark.parametrize("dies_at", range(5, 9))
def test_a_worker_that_joins_at_a_take_over_changes_no_belief(
    model: SensorModel, undisturbed: Living, dies_at: int
) -> None:
    living = Living(model).drive_on(dies_at)
    living.coordinator = None
    living.drive(dies_at)
    living.start_worker("new")
    living.revive()
    assert_same(living.drive_on(STEPS), undisturbed)


@pytest.mark.parametrize("changed_at", [6, 15])
def test_a_worker_that_continues_a_cluster_weighs_each_step_with_its_live_settings(
    model: SensorModel, changed_at: int
) -> None:
    def driven(*, dies: bool) -> Living:
        living = Living(model, workers=2).drive_on(changed_at)
        living.live = LiveSettings(drive_noise_per_metre=0.4, max_beams=12)
        living.drive_on(18)
        if dies:
            living.kill_worker("w0")
            living.start_worker("new")
        return living.drive_on(STEPS)

    assert_same(driven(dies=True), driven(dies=False))


def test_clusters_are_kept_without_workers_and_continue_when_one_appears(
    model: SensorModel, undisturbed: Living
) -> None:
    living = Living(model).drive_on(18)
    for name in tuple(living.workers):
        living.kill_worker(name)
    living.start_worker("late")
    assert_same(living.drive_on(STEPS), undisturbed)


@pytest.mark.parametrize(
    ("killed", "started"),
    [
        pytest.param(("w1", "w2"), (), id="one is left"),
        pytest.param(
            ("w0", "w1", "w2"), ("new",), id="all: the bridge proves that the file counts"
        ),
    ],
)
def test_clusters_whose_workers_die_with_the_coordinator_are_drawn_from_their_gaussians(
    model: SensorModel, undisturbed: Living, killed: tuple[str, ...], started: tuple[str, ...]
) -> None:
    """No hypothesis is lost, though no process has its particles."""
    living = Living(model).drive_on(18)
    living.coordinator = None
    for name in killed:
        living.kill_worker(name)
    living.revive()
    for name in started:
        living.start_worker(name)
    (before,) = undisturbed.beliefs[17]
    assert essence(living.beliefs[17][-1]) == essence(before)
    living.drive(18)
    living.wait(1.6)  # their workers might have come back
    (after,) = undisturbed.beliefs[18]
    (believed,) = living.beliefs[18]
    assert {h.cluster for h in believed.hypotheses} == {h.cluster for h in after.hypotheses}
    assert believed.missing == ()


def test_a_coordinator_that_finds_the_workers_late_continues_from_the_state(
    model: SensorModel, undisturbed: Living
) -> None:
    """Router and coordinator restarted together: the workers' links return last."""
    living = Living(model).drive_on(16)
    reachable, living.workers = living.workers, {}
    living.revive()
    assert living.coordinator.term.begun
    for step in (16, 17):
        living.drive(step)
        assert all(not b.hypotheses for b in living.beliefs.pop(step, [])), "no report can come"
    for name, worker in reachable.items():
        living.workers[name] = worker
        for step in (16, 17):
            worker.on_scan(living.scans[step])
        living.join(name)
    assert_same(living.drive_on(STEPS), undisturbed)


def test_coordinator_and_workers_follow_a_bridge_that_restarts_its_steps(
    model: SensorModel,
) -> None:
    """Bridge and coordinator restarted together; the workers know the old count."""
    living = Living(model).drive_on(14)
    living.revive()
    living.scans.clear()
    living.beliefs.clear()
    for step in range(12):
        living.drive(step, stamp_ns=(100 + step) * 10**9)
    beliefs = {step: reported[-1] for step, reported in living.beliefs.items()}
    assert set(beliefs) == set(range(2, 12)), "three scans in a row prove it"
    assert all(belief.missing == () for belief in beliefs.values())
    assert all(place.age_steps == 0 for place in beliefs[2].hypotheses), "found anew"
    assert beliefs[11].hypotheses


@pytest.mark.parametrize("step", [HUGE_JUMP + 100, MAX_SCAN_STEP - 1])
def test_one_scan_of_a_step_far_ahead_changes_nothing(
    model: SensorModel, undisturbed: Living, step: int
) -> None:
    living = Living(model).drive_on(14)
    living.drive(step, stamp_ns=13 * 10**9 + 1, like=13)
    living.scans.pop()
    assert_same(living.drive_on(STEPS), undisturbed)


def given(command_id: str, x_m: float) -> SetPose:
    return SetPose(sender="client", command_id=command_id, pose=(x_m, 2.0, 0.5))


def test_a_command_is_not_repeated_after_a_restart_and_random_streams_of_commands_continue(
    model: SensorModel,
) -> None:
    one, two = Living(model).drive_on(14), Living(model).drive_on(14)
    for living in (one, two):
        living.command(given("7", 2.0))
    first = two.beliefs[13][-1]
    assert first.hypotheses[0].pose == (2.0, 2.0, 0.5)
    two.revive()
    two.command(given("7", 2.0))
    assert essence(two.beliefs[13][-1]) == essence(first)
    for living in (one, two):
        living.command(given("8", 3.0))
    assert one.particles() == two.particles()
