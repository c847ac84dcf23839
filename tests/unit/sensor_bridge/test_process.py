import pytest

from clustermcl.protocol.errors import RecordingError, SettingsError
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.process import source_of


def test_a_live_robot_needs_no_source() -> None:
    assert source_of(BridgeSettings(source="zenoh")) is None


@pytest.mark.parametrize(
    ("source", "error", "words"),
    [
        ("nowhere.log", RecordingError, r"nowhere\.log"),
        ("sim:cross", SettingsError, "sim:cross.*clustermcl.simulator"),
    ],
)
def test_a_source_that_cannot_be_read_is_refused(
    source: str, error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        source_of(BridgeSettings(source=source))
