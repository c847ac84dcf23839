import pytest

from live_view.commands import (
    AskAdvice,
    Command,
    Drawn,
    DriveRobot,
    KidnapRobot,
    PlaceRobot,
    Request,
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
from protocol.message import Message


@pytest.mark.parametrize(
    ("text", "request_of_the_page"),
    [
        ('{"type": "drawn"}', Drawn()),
        ('{"type": "drawn", "count": 3, "slow": true}', Drawn(3, slow=True)),
        ('{"type": "relocalize"}', SearchAgain()),
        ('{"type": "set_pose", "pose": [1, 2.5, -3]}', PlaceRobot((1, 2.5, -3))),
        ('{"type": "update"}', UpdateOnce()),
        ('{"type": "advise"}', AskAdvice()),
        ('{"type": "kidnap"}', KidnapRobot()),
        ('{"type": "kidnap", "pose": [1, 2, 3]}', KidnapRobot((1, 2, 3))),
        ('{"type": "past", "step": 7}', ShowPast(7)),
        ('{"type": "earlier", "before": 7}', ShowEarlier(7)),
        ('{"type": "drive", "speed_m_s": 0.6, "turn_rate_rad_s": -1}', DriveRobot(0.6, -1.0)),
    ],
)
def test_requests_of_the_page_are_parsed(text: str, request_of_the_page: Request) -> None:
    assert parsed_request(text) == request_of_the_page


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


POSE = (1.0, 2.0, 3.0)
ME = {"sender": "me", "command_id": "id"}


@pytest.mark.parametrize(
    ("command", "key", "message"),
    [
        (
            PlaceRobot(POSE, 0.2, 0.1),
            keys.SET_POSE,
            SetPose(**ME, pose=POSE, position_sigma_m=0.2, heading_sigma_rad=0.1),
        ),
        (SearchAgain(), keys.RELOCALIZE, Relocalize(**ME)),
        (UpdateOnce(), keys.UPDATE, Update(**ME)),
        (KidnapRobot(POSE), keys.KIDNAP, Kidnap(**ME, pose=POSE)),
        (
            DriveRobot(0.5, 1.0, by_hand=False),
            keys.DRIVE,
            Drive(sender="me", speed_m_s=0.5, turn_rate_rad_s=1.0, by_hand=False),
        ),
    ],
)
def test_a_ros_command_becomes_the_message_of_the_protocol(
    command: Command, key: str, message: Message
) -> None:
    assert message_of(command, "me", "id") == (key, message)
