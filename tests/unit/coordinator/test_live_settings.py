"""Settings that change while a robot drives: carried by scans, known to the next coordinator."""

from clustermcl.filter.settings import FilterSettings
from clustermcl.protocol.live_settings import AS_STARTED, LiveSettings
from clustermcl.runtime.settings import BridgeSettings
from tests.unit.coordinator.reports import tracked
from tests.unit.coordinator.test_coordinator import NORTH, Story

LIVE = LiveSettings(turn_noise_per_turn=0.4, hit_weight=0.5, gate_distance_m=0.7)


def goes_by(story: Story) -> tuple[float, float, float, float]:
    state = story.coordinator.state
    since = state.pose.since_step
    return (
        state.ensemble.settings.motion.turn_noise_per_turn,
        since.motion.turn_noise_per_turn,
        state.ensemble.clusters.sensor.hit_weight,
        since.bridge.gate_distance_m,
    )


def test_the_settings_of_the_applied_scan_hold_and_a_successor_keeps_them() -> None:
    usual = FilterSettings()
    started = (
        *(usual.motion.turn_noise_per_turn,) * 2,
        usual.sensor.hit_weight,
        BridgeSettings().gate_distance_m,
    )
    story = Story("a")
    story.scan(0)
    story.finds({NORTH: 1.0})
    assert goes_by(story) == started
    story.scan(1, settings=LIVE)
    story.report(tracked("c0", 1, 0.1, NORTH), at_s=1.1)
    heir = Story("a", known=story.checkpoints[-1])
    for one in (story, heir):
        assert goes_by(one) == (0.4, 0.4, 0.5, 0.7)
        assert one.status(2.0).settings == LIVE
    heir.scan(2)
    heir.tick(at_s=60.0)
    assert goes_by(heir) == started
    assert heir.coordinator.state.live == AS_STARTED
