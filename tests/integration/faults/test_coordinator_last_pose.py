"""A power cut: the state is on disk, and its place is one hypothesis of the next life."""

from pathlib import Path

from msgspec.structs import replace

from clustermcl.coordinator import state_file
from clustermcl.coordinator.checkpoint import state_in
from clustermcl.coordinator.recovery import LastPlace
from clustermcl.runtime.settings import BridgeSettings, CoordinatorSettings, Settings
from tests.integration.faults.system import SMALL, system
from tests.integration.waiting import wait_until


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
