"""The log: standard error, one line per event, prefixed with the process's name."""

import logging
import math
import sys
from collections import Counter
from typing import Any

from clustermcl.protocol.errors import escaped

_FORMAT = "%(asctime)s.%(msecs)03d %(levelname)-7s {process}: %(message)s"


class _OneLine(logging.Formatter):
    """Joins a message's lines into one; only the traceback of a bug has several."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - logging's name
        return " | ".join(map(escaped, super().formatMessage(record).splitlines()))

    def formatException(self, ei: Any) -> str:  # noqa: N802 - logging's name
        return "\n".join(map(escaped, super().formatException(ei).split("\n")))


def configure_logging(process: str, level: str) -> None:
    """Configure the log: messages from `level` upwards on standard error. May be called again."""
    handler = logging.StreamHandler(sys.stderr)
    name = process.replace("%", "%%")
    handler.setFormatter(_OneLine(_FORMAT.format(process=name), datefmt="%H:%M:%S"))
    logging.basicConfig(handlers=[handler], level=level.upper(), force=True)
    logging.getLogger("numba").setLevel(logging.WARNING)  # logs all bytecode it compiles


def is_quiet() -> bool:
    """Return whether only errors are printed: no progress, no notes."""
    return logging.getLogger().level >= logging.ERROR


class CauseCounter:
    """Counts repeated faults and logs each cause at most once a period.

    Ten malformed scans a second would flood the log. Causes are constants of the program, never
    text from the wire, so the counter's size is bounded.
    """

    def __init__(self, period_s: float = 60.0) -> None:
        self.total: Counter[str] = Counter()
        self._period_s = period_s
        self._unreported: Counter[str] = Counter()
        self._reported_at_s: dict[str, float] = {}

    def warn(self, log: logging.Logger, cause: str, detail: object, now_s: float) -> None:
        """Count one fault and, at most once a period, log its cause with the newest detail."""
        self.total[cause] += 1
        self._unreported[cause] += 1
        if now_s - self._reported_at_s.get(cause, -math.inf) >= self._period_s:
            self._reported_at_s[cause], times = now_s, self._unreported.pop(cause)
            log.warning("%s%s: %s", cause, f" ({times} times)" if times > 1 else "", detail)
