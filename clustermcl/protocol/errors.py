"""The errors that a user, a file or another process can cause.

All are a `ClusterMclError`, whose text is one sentence; programs print it and exit with 2.
A wrong argument inside the code raises `ValueError`.
"""

import json
from pathlib import Path

from clustermcl.protocol.causes import Named


class ClusterMclError(Exception):
    """Base class of all errors that a user can cause or fix; process pools can return them."""

    def __reduce__(self) -> tuple[object, ...]:
        """Restore the attributes without `__init__`, whose arguments pickle does not know."""
        return _without_init, (type(self), *self.args), self.__dict__


class InputFileError(ClusterMclError):
    """A map, recording, reference or settings file is unusable."""

    def __init__(self, path: Path | str, problem: str, *, line: int | None = None) -> None:
        self.path, self.problem, self.line = Path(path), problem, line
        where = f"{path}:{line}" if line is not None else f"{path}"
        super().__init__(f"{where}: {problem}")


class MapFileError(InputFileError):
    """A map file is missing, corrupt, or has no free space."""


class LandmarksFileError(InputFileError):
    """A landmarks file is missing or corrupt, or gives two landmarks the same name."""


class RecordingError(InputFileError):
    """A recording is missing, corrupt, or has no scan."""


class ReferenceFileError(InputFileError):
    """A reference trajectory is missing or corrupt."""


class SettingsError(ClusterMclError):
    """A setting or an option is unknown, of the wrong type, out of range, or unusable.

    Args:
        problem: a sentence that names the key.
        key: the setting, such as ``bridge.map``, or the option, such as ``--map``; by default the
            first word of the problem.
        where: the file, or ``--set``; None: unknown.
    """

    def __init__(self, problem: str, *, key: str = "", where: str | None = None) -> None:
        self.key = key or problem.split(maxsplit=1)[0].rstrip(":")
        self.problem, self.where = problem, where
        super().__init__(problem if where is None else f"{where}: {problem}")


class MalformedMessageError(ClusterMclError):
    """Bytes from the wire are not a valid message of the expected type.

    Args:
        problem: the reason; may quote the bytes, so it is truncated and made printable.
        kind: ``too large``, ``not MessagePack``, ``schema`` (another message or version),
            ``field``, ``impossible`` (implausible numbers), or ``wrong array``.
    """

    def __init__(self, *, expected: str, problem: str, kind: str = "impossible") -> None:
        self.expected, self.kind = expected, kind
        self.problem = printable(problem)
        super().__init__(f"not a valid {expected}: {self.problem}")

    @property
    def cause(self) -> Named:
        """Name of its counter; contains no text from the wire."""
        return Named(f"malformed {self.expected}: {self.kind}")


class MapMismatchError(ClusterMclError):
    """A process localizes in another map, so its poses cannot be compared with the others'."""

    def __init__(self, *, worker: str, expected: str, found: str) -> None:
        self.worker, self.expected, self.found = worker, expected, found
        super().__init__(f"{worker!r} has map {found:.12}, expected {expected:.12}")


class OldTermError(ClusterMclError):
    """An order comes from a coordinator that has been replaced by another one."""

    def __init__(self, *, term: int, ruling: int) -> None:
        self.term, self.ruling = term, ruling
        super().__init__(f"order of term {term}, but the current term is {ruling}")


class UnreachableError(ClusterMclError):
    """The router, or a process behind it, did not answer in time.

    `peer` is the router, a process, or the key of the query, to which `problem` is a sentence.
    """

    def __init__(
        self, *, peer: str, problem: str, waited_s: float, endpoint: str | None = None
    ) -> None:
        self.peer, self.problem, self.waited_s, self.endpoint = peer, problem, waited_s, endpoint
        super().__init__(problem)


class RefusedError(UnreachableError):
    """A process is there, but refuses to answer now; arguments as for `UnreachableError`."""


class CommandRefusedError(ClusterMclError):
    """A command was understood but refused."""

    def __init__(self, *, command: str, problem: str) -> None:
        self.command, self.problem = command, problem
        super().__init__(problem)


class AlreadyRunningError(ClusterMclError):
    """A second coordinator or bridge was started for a robot, or a second router at an endpoint.

    `what` is such as ``a coordinator``, `advice` a remedy; without a `robot` it is a router.
    """

    def __init__(self, *, what: str, endpoint: str, advice: str, robot: str | None = None) -> None:
        self.what, self.endpoint, self.advice, self.robot = what, endpoint, advice, robot
        taken = f"{endpoint} is in use: {what} already listens there; "
        if robot is not None:
            taken = f"robot {robot!r} already has {what} at {endpoint}: "
        super().__init__(taken + advice)


def _without_init(kind: type[ClusterMclError], *args: object) -> ClusterMclError:
    return kind.__new__(kind, *args)


def printable(text: str, at_most: int = 200) -> str:
    """Make untrusted text safe to log: one line, no control characters, at most this long."""
    safe = escaped(text[: at_most + 1])
    return safe if len(safe) <= at_most else f"{safe[:at_most]}..."


def escaped(text: str) -> str:
    """Escape control characters as JSON does; a terminal would obey those in a peer's text."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in text)
