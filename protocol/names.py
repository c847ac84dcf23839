"""Names of robots and processes: parts of keys, file names and log lines, and of certificates."""

import re

LONGEST_NAME = 64
ROOM_FOR_NUMBER = 8
"""Of a process's name: its children are called NAME-0, NAME-1 and so on."""

NAME_PATTERN = r"\A[A-Za-z0-9_]+(-[A-Za-z0-9_]+)*\Z"
"""No wildcard or slash of Zenoh's, and no dot: a certificate is called ROLE.ROBOT."""

_NAME = re.compile(NAME_PATTERN)


def is_name(text: str, longest: int = LONGEST_NAME) -> bool:
    """Whether a robot or a process may be called so."""
    return len(text) <= longest and _NAME.search(text) is not None


def name_rule(longest: int = LONGEST_NAME) -> str:
    """The same in words."""
    return f"letters, digits, _ and single - between them, at most {longest}"
