"""The log: standard error, a line an event, the process's name in front."""

import logging
import sys
from collections import Counter

_FORMAT = "%(asctime)s.%(msecs)03d %(levelname)-7s {process}: %(message)s"


class _OneLine(logging.Formatter):
    """A message is one line; only the traceback of a bug, which follows it, has more."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - logging's name
        return " | ".join(super().formatMessage(record).splitlines())


def configure_logging(process: str, level: str) -> None:
    """Send this process's log to standard error, from `level` upwards; may be called again.

    Args:
        process: name in front of each line, such as ``coordinator`` or ``worker-3``.
        level: ``debug``, ``info``, ``warning`` or ``error``.
    """
    handler = logging.StreamHandler(sys.stderr)
    name = process.replace("%", "%%")
    handler.setFormatter(_OneLine(_FORMAT.format(process=name), datefmt="%H:%M:%S"))
    logging.basicConfig(handlers=[handler], level=level.upper(), force=True)
    logging.getLogger("numba").setLevel(logging.WARNING)  # tells every byte that it compiles


def is_quiet() -> bool:
    """Whether nothing but errors is to be said: no progress, and nothing on the way."""
    return logging.getLogger().level >= logging.ERROR


class CauseCounter:
    """Counts what goes wrong again and again, and says each cause once a period.

    Ten malformed scans a second would bury the log; none in it would hide them. Causes are
    fixed words of the program, never text from the wire, so the counter does not grow.
    """

    def __init__(self, period_s: float = 60.0) -> None:
        self.total: Counter[str] = Counter()
        """How often each cause happened since the start."""
        self._period_s = period_s
        self._unsaid: Counter[str] = Counter()
        self._said_at_s: dict[str, float] = {}

    def count(self, cause: str, now_s: float) -> int:
        """Count one more; return how many to speak of now, 0 while the cause was just said."""
        self.total[cause] += 1
        self._unsaid[cause] += 1
        said_at_s = self._said_at_s.get(cause)
        if said_at_s is not None and now_s - said_at_s < self._period_s:
            return 0
        self._said_at_s[cause] = now_s
        return self._unsaid.pop(cause)

    def warn(self, log: logging.Logger, cause: str, detail: object, now_s: float) -> None:
        """Count one more and, once a period, log the cause with the newest detail.

        Args:
            log: where the warning goes.
            cause: fixed words, such as ``malformed scan dropped``.
            detail: the facts of this case, usually the error.
            now_s: time on a clock that does not jump [s].
        """
        if times := self.count(cause, now_s):
            log.warning("%s%s: %s", cause, f" ({times} times)" if times > 1 else "", detail)
