import msgspec
import pytest

from clustermcl.protocol.answers import Drive, Kidnap, Relocalize, SetPose, Update
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.view.commands import (
    AskAdvice,
    Drawn,
    Request,
    ShowEarlier,
    ShowPast,
    parsed_request,
)

PAGE = {"sender": "view"}
COMMAND = {**PAGE, "command_id": "id"}
POSE = (1.0, 2.5, -3.0)


@pytest.mark.parametrize(
    ("text", "request_of_the_page"),
    [
        ('{"type": "drawn"}', Drawn()),
        ('{"type": "drawn", "count": 3, "slow": true}', Drawn(3, slow=True)),
        ('{"type": "relocalize"}', Relocalize(**COMMAND)),
        ('{"type": "set_pose", "pose": [1, 2.5, -3]}', SetPose(**COMMAND, pose=POSE)),
        ('{"type": "set_pose", "pose": [1, 2.5, -3], "position_sigma_m": 0.2}',
         SetPose(**COMMAND, pose=POSE, position_sigma_m=0.2)),
        ('{"type": "update"}', Update(**COMMAND)),
        ('{"type": "advise"}', AskAdvice()),
        ('{"type": "kidnap"}', Kidnap(**COMMAND)),
        ('{"type": "kidnap", "pose": [1, 2.5, -3]}', Kidnap(**COMMAND, pose=POSE)),
        ('{"type": "past", "step": 7}', ShowPast(7)),
        ('{"type": "earlier", "before": 7}', ShowEarlier(7)),
        ('{"type": "drive", "speed_m_s": 0.6, "turn_rate_rad_s": -1}',
         Drive(**PAGE, speed_m_s=0.6, turn_rate_rad_s=-1.0)),
        ('{"type": "drive", "by_hand": false, "sender": "another"}', Drive(**PAGE, by_hand=False)),
    ],
)  # fmt: skip
def test_requests_of_the_page_are_parsed(text: str, request_of_the_page: Request) -> None:
    parsed = parsed_request(text)
    if isinstance(parsed, Relocalize | SetPose | Update | Kidnap):
        assert parsed != parsed_request(text), "each command has an id of its own"
        parsed = msgspec.structs.replace(parsed, command_id="id")
    assert parsed == request_of_the_page


@pytest.mark.parametrize("text", [
    "", "[]", b"\xff", '{"type": "drawn", "x": ' + 970 * "[", '{"type": "shutdown"}',
    '{"type": ["set_pose"]}', '{"type": "drive", "speed_m_s": 1e999}',
    '{"type": "drawn", "more": 1}', '{"type": "drawn", "count": -1}',
    '{"type": "past", "step": -1}', '{"type": "past", "step": 1.5}', '{"type": "set_pose"}',
    *(f'{{"type": "set_pose", "pose": {pose}}}' for pose in (
        "[1, 2]", "[1, 2, 1e999]", "[1e9, 2, 3]")),
    '{"type": "set_pose", "pose": [1, 2, 3], "position_sigma_m": 0}',
])  # fmt: skip
def test_malformed_requests_are_refused(text: str | bytes) -> None:
    with pytest.raises(MalformedMessageError):
        parsed_request(text)
