"""What a browser may ask for: read, checked, and turned into a message of the system."""

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


class Drawn(msgspec.Struct, frozen=True, tag_field="type", tag="drawn", forbid_unknown_fields=True):
    """The page has drawn the last messages; a slow one says so after each."""

    count: Annotated[int, msgspec.Meta(ge=1, le=100)] = 1
    slow: bool = False
    """Drawing takes long: it wants a message only when it has drawn the last."""


class ShowPast(
    msgspec.Struct, frozen=True, tag_field="type", tag="past", forbid_unknown_fields=True
):
    """A person looks back at a step."""

    step: _Step


class ShowEarlier(
    msgspec.Struct, frozen=True, tag_field="type", tag="earlier", forbid_unknown_fields=True
):
    """The page wants the ways of the steps before those it has."""

    before: _Step


class PlaceRobot(
    msgspec.Struct, frozen=True, tag_field="type", tag="set_pose", forbid_unknown_fields=True
):
    """A person has dragged an arrow to where the robot is."""

    pose: _Pose
    position_sigma_m: _Sigma = 0.5
    heading_sigma_rad: _Sigma = 0.26


class SearchAgain(
    msgspec.Struct, frozen=True, tag_field="type", tag="relocalize", forbid_unknown_fields=True
):
    """A person has said yes to forgetting all places."""


class LookOnce(
    msgspec.Struct, frozen=True, tag_field="type", tag="update", forbid_unknown_fields=True
):
    """A person wants a step of the next scan, although the robot stands."""


class KidnapRobot(
    msgspec.Struct, frozen=True, tag_field="type", tag="kidnap", forbid_unknown_fields=True
):
    """A person lifts the simulated robot."""

    pose: _Pose | None = None
    """Where to; None: somewhere far away."""


class DriveRobot(
    msgspec.Struct, frozen=True, tag_field="type", tag="drive", forbid_unknown_fields=True
):
    """A person drives the simulated robot, or lets it go."""

    speed_m_s: _Rate = 0.0
    turn_rate_rad_s: _Rate = 0.0
    by_hand: bool = True


Question: TypeAlias = ShowPast | ShowEarlier
Command: TypeAlias = PlaceRobot | SearchAgain | LookOnce | KidnapRobot | DriveRobot
Request: TypeAlias = Drawn | Question | Command

MAX_REQUEST_BYTES = 1000


def parsed_request(text: str | bytes) -> Request:
    """What a browser has sent.

    Raises:
        MalformedMessageError: it is nothing that our page sends.
    """
    try:
        request: Request = msgspec.json.decode(text, type=Request)
    except (msgspec.DecodeError, UnicodeError) as error:
        raise MalformedMessageError(expected="request of the page", problem=str(error)) from None
    return request


def message_of(command: Command, sender: str, command_id: str) -> tuple[str, Message]:
    """Key and message of a command."""
    match command:
        case PlaceRobot(pose, position_sigma_m, heading_sigma_rad):
            return keys.SET_POSE, SetPose(
                sender=sender,
                command_id=command_id,
                map_from_robot=pose,
                position_sigma_m=position_sigma_m,
                heading_sigma_rad=heading_sigma_rad,
            )
        case SearchAgain():
            return keys.RELOCALIZE, Relocalize(sender=sender, command_id=command_id)
        case LookOnce():
            return keys.UPDATE, Update(sender=sender, command_id=command_id)
        case KidnapRobot(pose):
            return keys.KIDNAP, Kidnap(sender=sender, command_id=command_id, map_from_robot=pose)
        case DriveRobot(speed_m_s, turn_rate_rad_s, by_hand):
            return keys.DRIVE, Drive(
                sender=sender,
                speed_m_s=speed_m_s,
                turn_rate_rad_s=turn_rate_rad_s,
                by_hand=by_hand,
            )
