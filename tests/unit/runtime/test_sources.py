import pytest

from clustermcl.runtime.settings import BridgeSettings
from clustermcl.runtime.sources import Live, Recorded, Simulated, SourceChoice, parsed_source


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (BridgeSettings().source, Live()),
        ("zenoh", Live()),
        ("./zenoh", Recorded("./zenoh")),
        ("sim:cross", Simulated("cross")),
        ("sim:maps/hall.yaml", Simulated("maps/hall.yaml")),
        ("sim:", Simulated("")),
        ("robot.log.gz", Recorded("robot.log.gz")),
        ("sim/robot.log", Recorded("sim/robot.log")),
    ],
)
def test_a_source_is_parsed_as_simulation_recording_or_robot(
    text: str, expected: SourceChoice
) -> None:
    assert parsed_source(text) == expected
