import pytest

from process_runtime.settings import BridgeSettings
from protocol.errors import RecordingError, SettingsError
from sensor_bridge.process import source_of


def test_a_live_robot_needs_no_source() -> None:
    assert source_of(BridgeSettings(source="zenoh")) is None


def test_the_bridge_reads_a_recording() -> None:
    with pytest.raises(RecordingError, match=r"nowhere\.log"):
        source_of(BridgeSettings(source="nowhere.log"))


def test_the_bridge_refuses_a_simulated_source() -> None:
    with pytest.raises(SettingsError, match=r"sim:cross.*robot_simulator"):
        source_of(BridgeSettings(source="sim:cross"))
