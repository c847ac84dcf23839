"""Counts what the bridge refused, bridged or missed, and attaches it to the next step."""

from collections import Counter
from typing import Any

from clustermcl.protocol.causes import AnyCause, Cause
from clustermcl.protocol.job_events import Remark
from clustermcl.protocol.steps import MAX_REMARKS

REPEATED_AFTER_NS = 60_000_000_000
"""Steps carry a cause again only after this time by the robot's clock [ns]."""


class Refused(Counter[AnyCause]):
    """Readings that were not used, by cause; also jumps, restarts of the clock, and gaps.

    Attributes:
        details: the newest occurrence of some causes, in words.
    """

    def __init__(self, *counts: Any) -> None:
        super().__init__(*counts)
        self.details: dict[AnyCause, str] = {}
        self._remarked = Counter[AnyCause]()
        self._remarked_ns: dict[AnyCause, int] = {}

    def add(self, cause: Cause, detail: str) -> None:
        self[cause] += 1
        self.details[cause] = detail

    def remarks(self, stamp_ns: int) -> tuple[Remark, ...]:
        """Return what was counted since the last step; each cause at most once a minute."""
        remarks = list[Remark]()
        for cause, count in self.items():
            new = count - self._remarked[cause]
            last_ns = self._remarked_ns.get(cause)
            is_early = last_ns is not None and 0 <= stamp_ns - last_ns < REPEATED_AFTER_NS
            if new and not is_early and len(remarks) < MAX_REMARKS:
                self._remarked[cause], self._remarked_ns[cause] = count, stamp_ns
                times = f"{new} times" if new > 1 else ""
                detail = ", ".join(filter(None, (self.details.get(cause, ""), times)))
                remarks.append(Remark(cause=cause, detail=detail))
        return tuple(remarks)
