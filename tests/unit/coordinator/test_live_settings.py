"""Settings that change while a robot drives: carried by scans, known to the next coordinator."""

import msgspec
import pytest

from coordinator.state import CoordinatorState
from particle_filter.sensor_model import SensorModel
from particle_filter.settings import FilterSettings
from process_runtime.settings import BridgeSettings
from protocol.live_settings import AS_STARTED, LiveSettings
from tests.unit.coordinator import living
from tests.unit.coordinator.living import Living, scan_of

LIVE = LiveSettings(turn_noise_per_turn=0.4, hit_weight=0.5, gate_distance_m=0.7)


def state_of(tested: Living) -> CoordinatorState:
    assert tested.coordinator is not None
    return tested.coordinator.state


def goes_by(state: CoordinatorState) -> tuple[float, float, float, float]:
    since = state.pose.since_step
    return (
        state.ensemble.settings.motion.turn_noise_per_turn,
        since.motion.turn_noise_per_turn,
        state.ensemble.clusters.sensor.hit_weight,
        since.bridge.gate_distance_m,
    )


def test_the_settings_of_the_applied_scan_hold_and_a_successor_keeps_them(
    model: SensorModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    tested = Living(model).drive_on(4)
    started = (
        *(living.SETTINGS.motion.turn_noise_per_turn,) * 2,
        living.SETTINGS.sensor.hit_weight,
        BridgeSettings().gate_distance_m,
    )
    assert goes_by(state_of(tested)) == started
    monkeypatch.setattr(
        living, "scan_of", lambda step: msgspec.structs.replace(scan_of(step), settings=LIVE)
    )
    tested.drive(4)
    assert goes_by(state_of(tested)) == (0.4, 0.4, 0.5, 0.7)
    assert tested.coordinator is not None
    assert tested.coordinator.status(tested._now_ns, {}).settings == LIVE
    tested.coordinator = None
    tested.revive()
    assert tested.coordinator
    assert goes_by(state_of(tested)) == (0.4, 0.4, 0.5, 0.7)
    assert tested.coordinator.status(tested._now_ns, {}).settings == LIVE
    monkeypatch.undo()
    tested.drive(5)
    assert goes_by(state_of(tested)) == started
    assert state_of(tested).live == AS_STARTED
    assert FilterSettings() != state_of(tested).ensemble.settings  # those of the test
