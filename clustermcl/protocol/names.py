"""Names of robots and processes, as used in keys, file names, logs and certificates."""

import re

LONGEST_NAME = 64
ROOM_FOR_NUMBER = 8
"""Characters left for the suffix of child processes, which are called NAME-0, NAME-1 and so on."""

NAME_PATTERN = r"\A[A-Za-z0-9_]+(-[A-Za-z0-9_]+)*\Z"
"""No wildcard or slash of Zenoh, and no dot: a certificate is called ROLE.ROBOT."""

_NAME = re.compile(NAME_PATTERN)


def is_name(text: str, longest: int = LONGEST_NAME) -> bool:
    """Return whether a text is a valid name of a robot or a process."""
    return len(text) <= longest and _NAME.search(text) is not None


def name_rule(longest: int = LONGEST_NAME) -> str:
    return f"letters, digits, _ and single - between them, at most {longest}"
