"""One tree of errors: what a peer, a file or a command did wrong, in one sentence each.

A wrong argument inside the code raises `ValueError`; everything a person or another process
can cause raises a `ClusterMclError`. Front ends print it as one line and exit with 2.
"""

from pathlib import Path


class ClusterMclError(Exception):
    """Root of all errors that a person can cause or mend."""


class InputFileError(ClusterMclError):
    """A map, recording, reference or settings file cannot be used."""

    def __init__(self, path: Path | str, problem: str, *, line: int | None = None) -> None:
        self.path, self.problem, self.line = Path(path), problem, line
        where = f"{path}:{line}" if line is not None else f"{path}"
        super().__init__(f"{where}: {problem}")


class MapFileError(InputFileError):
    """A map file is missing, broken, or holds nothing to localize in."""


class RecordingError(InputFileError):
    """A recording is missing, broken, or holds no scan."""


class ReferenceFileError(InputFileError):
    """A reference trajectory is missing or broken."""


class SettingsError(ClusterMclError):
    """A setting or an option is unknown, of the wrong type, out of its range, or cannot be used.

    Args:
        key: the setting, such as ``bridge.map``, or the option, such as ``--map``.
        problem: a sentence that names it.
        where: the file, or ``--set``; None where that is not known.
    """

    def __init__(self, *, key: str, problem: str, where: str | None = None) -> None:
        self.key, self.problem, self.where = key, problem, where
        super().__init__(problem if where is None else f"{where}: {problem}")


class ProtocolError(ClusterMclError):
    """A peer said something that this process cannot act on."""


class MalformedMessageError(ProtocolError):
    """Bytes from the wire are not the message they should be.

    Args:
        expected: which message they should be.
        problem: what is wrong with them; may quote them, so it is cut and made printable.
        kind: the same in fixed words: ``too large``, ``not MessagePack``, ``schema`` (another
            message, or another version of it), ``field``, ``impossible`` (numbers that no honest
            process sends), ``array that lies``.
    """

    def __init__(self, *, expected: str, problem: str, kind: str = "impossible") -> None:
        self.expected, self.kind = expected, kind
        self.problem = printable(problem)
        super().__init__(f"not a valid {expected}: {self.problem}")

    @property
    def cause(self) -> str:
        """What to count it as: never text from the wire."""
        return f"malformed {self.expected}: {self.kind}"


class MapMismatchError(ProtocolError):
    """Somebody localizes in another map: its poses cannot be compared with those of the others."""

    def __init__(self, *, worker: str, expected: str, found: str) -> None:
        self.worker, self.expected, self.found = worker, expected, found
        super().__init__(f"{worker!r} has map {found:.12}, expected {expected:.12}")


class OldTermError(ProtocolError):
    """An order comes from a coordinator that another one has taken over from."""

    def __init__(self, *, term: int, ruling: int) -> None:
        self.term, self.ruling = term, ruling
        super().__init__(f"order of term {term}, but term {ruling} rules")


class UnreachableError(ClusterMclError):
    """No router, or nobody behind it, answered in time.

    Args:
        who: the router, a process, or the key that was asked.
        problem: a sentence that names it.
        waited_s: how long an answer was waited for [s].
        endpoint: the router's; None where it is not known.
    """

    def __init__(
        self, *, who: str, problem: str, waited_s: float, endpoint: str | None = None
    ) -> None:
        self.who, self.problem, self.waited_s, self.endpoint = who, problem, waited_s, endpoint
        super().__init__(problem)


class RefusedError(UnreachableError):
    """Somebody is there and does not answer now; arguments as for `UnreachableError`."""


class CommandRefusedError(ClusterMclError):
    """A command was understood and will not be carried out."""

    def __init__(self, *, command: str, problem: str) -> None:
        self.command, self.problem = command, problem
        super().__init__(problem)


class AlreadyRunningError(ClusterMclError):
    """A second coordinator or bridge was started for a robot, or a second router at an endpoint.

    Args:
        what: what is there already, such as ``a coordinator``.
        endpoint: the router's.
        advice: what a person can do.
        robot: whose it is; None for what listens at the endpoint itself.
    """

    def __init__(self, *, what: str, endpoint: str, advice: str, robot: str | None = None) -> None:
        self.what, self.endpoint, self.advice, self.robot = what, endpoint, advice, robot
        taken = f"{endpoint} is in use: {what} listens there already; "
        if robot is not None:
            taken = f"robot {robot!r} has {what} already at {endpoint}: "
        super().__init__(taken + advice)


def printable(text: str, at_most: int = 200) -> str:
    """Text of a stranger's as a log may show it: one line, no control characters, not too long."""
    cut = text if len(text) <= at_most else f"{text[:at_most]}..."
    return "".join(c if c.isprintable() else "?" for c in cut)
