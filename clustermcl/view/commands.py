"""Parses the requests of a browser; its commands become messages of the system."""

import uuid
from typing import Annotated, TypeAlias, get_args

import msgspec

from clustermcl.protocol.answers import Kidnap, Relocalize, SetPose, Update
from clustermcl.protocol.conversion import converted, decoded
from clustermcl.protocol.errors import MalformedMessageError

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


class AskAdvice(_Request, frozen=True, tag="advise"):
    """Request for ways that distinguish the places."""


Command: TypeAlias = SetPose | Relocalize | Update | Kidnap
_OWN: TypeAlias = Drawn | ShowPast | ShowEarlier | AskAdvice
Request: TypeAlias = _OWN | Command

SENDER = "view"
MAX_REQUEST_BYTES = 1000
_COMMANDS: dict[str, type[Command]] = {
    kind.__struct_config__.tag: kind for kind in get_args(Command)
}


def parsed_request(text: str | bytes, sender: str = SENDER) -> Request:
    """Parse a request of a browser; `sender` is that of its commands."""
    try:
        fields = decoded(text, dict[str, object], msgspec.json)
        command = _COMMANDS.get(f"{fields.get('type')}/1")
        if command is None:
            own: Request = converted(fields, _OWN)  # type: ignore[arg-type] # a union
            return own
        return converted(fields | {"sender": sender, "command_id": uuid.uuid4().hex}, command)
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:  # nested too deeply
        raise MalformedMessageError(expected="request of the page", problem=str(error)) from None
