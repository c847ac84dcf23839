"""A browser's permitted commands."""

import pytest

from live_view.commands import (
    Drawn,
    DriveRobot,
    KidnapRobot,
    PlaceRobot,
    SearchAgain,
    ShowEarlier,
    ShowPast,
    UpdateOnce,
    message_of,
    parsed_request,
)
from protocol import keys
from protocol.answers import Drive, Kidnap, Relocalize, SetPose, Update
from protocol.errors import MalformedMessageError


def test_requests_of_the_page_are_parsed() -> None:
    assert parsed_request('{"type": "drawn"}') == Drawn()
    assert parsed_request('{"type": "drawn", "count": 3, "slow": true}') == Drawn(3, slow=True)
    assert parsed_request('{"type": "relocalize"}') == SearchAgain()
    assert parsed_request('{"type": "set_pose", "pose": [1, 2.5, -3]}') == PlaceRobot((1, 2.5, -3))
    assert parsed_request('{"type": "update"}') == UpdateOnce()
    assert parsed_request('{"type": "kidnap"}') == KidnapRobot()
    assert parsed_request('{"type": "kidnap", "pose": [1, 2, 3]}') == KidnapRobot((1, 2, 3))
    assert parsed_request('{"type": "past", "step": 7}') == ShowPast(7)
    assert parsed_request('{"type": "earlier", "before": 7}') == ShowEarlier(7)
    drive = '{"type": "drive", "speed_m_s": 0.6, "turn_rate_rad_s": -1, "by_hand": true}'
    assert parsed_request(drive) == DriveRobot(0.6, -1.0)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"type": "shutdown"}',
        '{"type": "set_pose"}',
        '{"type": "set_pose", "pose": [1, 2]}',
        '{"type": "set_pose", "pose": [1, 2, 1e999]}',
        '{"type": "set_pose", "pose": [1, 2, 3], "position_sigma_m": 0}',
        '{"type": "set_pose", "pose": [1e9, 2, 3]}',
        '{"type": "drawn", "more": 1}',
        '{"type": "drawn", "count": -1}',
        '{"type": "past", "step": -1}',
        '{"type": "past", "step": 1.5}',
        '{"type": "drive", "speed_m_s": 1e300}',
        b"\xff",
    ],
)
def test_malformed_requests_are_refused(text: str | bytes) -> None:
    with pytest.raises(MalformedMessageError):
        parsed_request(text)


def test_a_command_becomes_the_systems_own_message() -> None:
    key, message = message_of(PlaceRobot((1.0, 2.0, 3.0), 0.2, 0.1), "me", "id")
    assert (key, message) == (
        keys.SET_POSE,
        SetPose(
            sender="me",
            command_id="id",
            map_from_robot=(1.0, 2.0, 3.0),
            position_sigma_m=0.2,
            heading_sigma_rad=0.1,
        ),
    )
    assert message_of(SearchAgain(), "me", "id") == (
        keys.RELOCALIZE,
        Relocalize(sender="me", command_id="id"),
    )
    assert message_of(UpdateOnce(), "me", "id") == (
        keys.UPDATE,
        Update(sender="me", command_id="id"),
    )
    assert message_of(KidnapRobot((1.0, 2.0, 3.0)), "me", "id") == (
        keys.KIDNAP,
        Kidnap(sender="me", command_id="id", map_from_robot=(1.0, 2.0, 3.0)),
    )
    assert message_of(DriveRobot(0.5, 1.0, by_hand=False), "me", "id") == (
        keys.DRIVE,
        Drive(sender="me", speed_m_s=0.5, turn_rate_rad_s=1.0, by_hand=False),
    )
