"""Parses the requests of a browser, and converts its commands to messages of the system."""

from typing import Annotated, TypeAlias

import msgspec

from protocol import keys
from protocol.answers import Drive, Kidnap, Relocalize, SetPose, Update
from protocol.errors import MalformedMessageError
from protocol.message import MAX_POSE_M, Message

_Coordinate: TypeAlias = Annotated[float, msgspec.Meta(ge=-MAX_POSE_M, le=MAX_POSE_M)]
_Pose: TypeAlias = tuple[_Coordinate, _Coordinate, _Coordinate]
_Sigma: TypeAlias = Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)]
_Rate: TypeAlias = Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)]
_Step: TypeAlias = Annotated[int, msgspec.Meta(ge=0, le=2**53)]


class _Request(msgspec.Struct, frozen=True, tag_field="type", forbid_unknown_fields=True):
    """A JSON object from the page; the field ``type`` names its class."""


class Drawn(_Request, frozen=True, tag="drawn"):
    """Acknowledgement of drawn messages."""

    count: Annotated[int, msgspec.Meta(ge=1, le=100)] = 1
    """Number of messages drawn since the last acknowledgement."""
    slow: bool = False
    """Whether drawing takes long; each message then waits for the last acknowledgement."""


class ShowPast(_Request, frozen=True, tag="past"):
    """Request for the frames of a past step."""

    step: _Step


class ShowEarlier(_Request, frozen=True, tag="earlier"):
    """Request for the history rows before a step."""

    before: _Step


class PlaceRobot(_Request, frozen=True, tag="set_pose"):
    """Command to set the robot's pose."""

    pose: _Pose
    """The pose: x [m], y [m], heading [rad]."""
    position_sigma_m: _Sigma = 0.5
    heading_sigma_rad: _Sigma = 0.26


class SearchAgain(_Request, frozen=True, tag="relocalize"):
    """Command to drop all places and search."""


class UpdateOnce(_Request, frozen=True, tag="update"):
    """Command to use the next scan for a step, even if the robot stands still."""


class KidnapRobot(_Request, frozen=True, tag="kidnap"):
    """Command to kidnap the simulated robot."""

    pose: _Pose | None = None
    """The new pose: x [m], y [m], heading [rad]; None: a random pose far away."""


class AskAdvice(_Request, frozen=True, tag="advise"):
    """Request for ways that distinguish the places."""


class DriveRobot(_Request, frozen=True, tag="drive"):
    """Command to drive the simulated robot manually, or to end manual driving."""

    speed_m_s: _Rate = 0.0
    turn_rate_rad_s: _Rate = 0.0
    by_hand: bool = True
    """Whether to drive manually; False ends manual driving."""


Question: TypeAlias = ShowPast | ShowEarlier
Command: TypeAlias = PlaceRobot | SearchAgain | UpdateOnce | KidnapRobot | DriveRobot
Request: TypeAlias = Drawn | Question | Command | AskAdvice

MAX_REQUEST_BYTES = 1000


def parsed_request(text: str | bytes) -> Request:
    """Parse a request of a browser.

    Raises:
        MalformedMessageError: the text is not a request of the page.
    """
    try:
        request: Request = msgspec.json.decode(text, type=Request)
    except (msgspec.DecodeError, UnicodeError) as error:
        raise MalformedMessageError(expected="request of the page", problem=str(error)) from None
    return request


_MESSAGES: dict[type[Command], tuple[str, type[Message]]] = {
    PlaceRobot: (keys.SET_POSE, SetPose),
    SearchAgain: (keys.RELOCALIZE, Relocalize),
    UpdateOnce: (keys.UPDATE, Update),
    KidnapRobot: (keys.KIDNAP, Kidnap),
    DriveRobot: (keys.DRIVE, Drive),
}


def message_of(command: Command, sender: str, command_id: str) -> tuple[str, Message]:
    key, kind = _MESSAGES[type(command)]
    fields = msgspec.structs.asdict(command)
    if not isinstance(command, DriveRobot):  # a repeated drive command does no harm
        fields["command_id"] = command_id
    return key, kind(sender=sender, **fields)
