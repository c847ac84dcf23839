"""What a browser may ask for: read, checked, and turned into a message of the system."""

from typing import Annotated, TypeAlias

import msgspec

from protocol import keys
from protocol.answers import Relocalize, SetPose
from protocol.errors import MalformedMessageError
from protocol.message import MAX_POSE_M, PoseTuple

_Coordinate: TypeAlias = Annotated[float, msgspec.Meta(ge=-MAX_POSE_M, le=MAX_POSE_M)]
_Sigma: TypeAlias = Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)]


class Drawn(msgspec.Struct, frozen=True, tag_field="type", tag="drawn", forbid_unknown_fields=True):
    """The page has drawn what it was sent last."""


class PlaceRobot(
    msgspec.Struct, frozen=True, tag_field="type", tag="set_pose", forbid_unknown_fields=True
):
    """A person has dragged an arrow to where the robot is."""

    pose: tuple[_Coordinate, _Coordinate, _Coordinate]
    position_sigma_m: _Sigma = 0.5
    heading_sigma_rad: _Sigma = 0.26


class SearchAgain(
    msgspec.Struct, frozen=True, tag_field="type", tag="relocalize", forbid_unknown_fields=True
):
    """A person has said yes to forgetting all places."""


Request: TypeAlias = Drawn | PlaceRobot | SearchAgain
Command: TypeAlias = PlaceRobot | SearchAgain

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


def message_of(command: Command, sender: str, command_id: str) -> tuple[str, SetPose | Relocalize]:
    """Key and message of a command."""
    match command:
        case PlaceRobot(pose, position_sigma_m, heading_sigma_rad):
            placed: PoseTuple = pose
            return keys.SET_POSE, SetPose(
                sender=sender,
                command_id=command_id,
                map_from_robot=placed,
                position_sigma_m=position_sigma_m,
                heading_sigma_rad=heading_sigma_rad,
            )
        case SearchAgain():
            return keys.RELOCALIZE, Relocalize(sender=sender, command_id=command_id)
