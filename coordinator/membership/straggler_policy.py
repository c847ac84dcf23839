"""How long a worker that does not report is waited for: one deadline, and then it is given up.

The first step that it misses costs the others one deadline. From then on nobody waits for it until
it speaks again; after some steps more it loses its jobs to others. A worker that comes back takes
jobs again after a pause, which doubles each time: one that is too slow would else take jobs and
lose them for ever.

Workers that have reported before come first. The others of one certificate, which are called alike
but for their number, count as one until each has reported: else sixty names that answer orders and
compute nothing would hold up sixty times as many steps as one.
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass

GIVEN_UP_AFTER = 3
"""So many steps in a row without a report in time, and a worker loses its jobs."""
GIVEN_UP_LATER = 10
"""The same where everybody is slow."""
FIRST_PAUSE_NS = 2_000_000_000
LONGEST_PAUSE_NS = 60_000_000_000
FORGOTTEN_AFTER_NS = 120_000_000_000
"""Who has worked for so long since its last pause starts from the first one again."""


@dataclass
class _Record:
    missed: int = 0
    """Steps in a row."""
    silent: bool = False
    """It has missed a step and not been heard since."""
    paused: bool = False
    pause_ns: int = FIRST_PAUSE_NS
    """The next one's length."""
    pause_ends_ns: int = 0


def origin(worker: str) -> str:
    """A worker's name without its number: that of the machine and certificate it comes from."""
    prefix, _, number = worker.rpartition("-")
    return prefix if prefix and number.isdecimal() else worker


class StragglerPolicy:
    """Told who reported and who did not; answers whom to wait for and who may have jobs."""

    def __init__(self) -> None:
        self._records: dict[str, _Record] = {}
        """Of workers that have reported, by name; of the others by origin."""
        self._proven: set[str] = set()
        """Workers that have reported."""

    def heard(self, worker: str, *, in_time: bool) -> None:
        """A report of a worker arrived; a late one is a sign of life, no more."""
        self._proven.add(worker)
        record = self._records.get(worker)
        if record is not None:
            record.silent = False
            record.missed = 0 if in_time else record.missed

    def step_decided(
        self, reported: Set[str], missing: Set[str], now_ns: int, *, patient: bool = False
    ) -> list[str]:
        """A step was decided without some reports; who is given up for it.

        Args:
            reported: workers that reported the step with one of their jobs.
            missing: workers that owed a report and did not send it in time.
            now_ns: by the clock of the process.
            patient: everybody is slow.
        """
        if not reported:  # not one worker is slow then, but the way to all of them
            return []
        late: dict[str, list[str]] = {}
        for worker in sorted(missing - reported):
            late.setdefault(self._who(worker), []).append(worker)
        given_up = []
        for who, workers in late.items():
            record = self._records.setdefault(who, _Record())
            record.missed += 1
            record.silent = True
            if record.missed >= (GIVEN_UP_LATER if patient else GIVEN_UP_AFTER):
                given_up += workers
                self._pause(record, now_ns)
        return given_up

    def give_up(self, worker: str, now_ns: int) -> bool:
        """Let a worker have no new jobs for a while; returns whether it has never reported."""
        self._pause(self._records.setdefault(self._who(worker), _Record()), now_ns)
        return worker not in self._proven

    def is_proven(self, worker: str) -> bool:
        """Whether a worker has reported."""
        return worker in self._proven

    def trusted(self, workers: Sequence[str]) -> list[str]:
        """Those that may have as many jobs as others: they or others of their origin have reported.

        While none has, it is all; never those of an origin that was given up.
        """
        known = {origin(worker) for worker in self._proven}
        return [
            worker
            for worker in workers
            if worker in self._proven
            or ((not known or origin(worker) in known) and not self._was_given_up(origin(worker)))
        ]

    def _was_given_up(self, who: str) -> bool:
        record = self._records.get(who)
        return record is not None and record.pause_ends_ns > 0

    def _who(self, worker: str) -> str:
        return worker if worker in self._proven else origin(worker)

    def waits_for(self, worker: str) -> bool:
        """Whether a step is held up for a worker."""
        record = self._records.get(self._who(worker))
        return record is None or not record.silent

    def may_work(self, worker: str, now_ns: int, *, answers: bool) -> bool:
        """Whether a worker may have jobs.

        Args:
            worker: its name.
            now_ns: by the clock of the process.
            answers: it has answered its last order; one that was frozen is back then.
        """
        record = self._records.get(self._who(worker))
        if record is None or not record.paused:
            return True
        if answers and now_ns >= record.pause_ends_ns:
            record.paused = False
            record.silent = worker not in self._proven  # a trial holds up no step
        return not record.paused

    def forget(self, worker: str) -> None:
        """A worker is gone; one of the same name is another, and has reported nothing."""
        if worker in self._proven:
            self._proven.discard(worker)
            self._records.pop(worker, None)

    def _pause(self, record: _Record, now_ns: int) -> None:
        if now_ns > record.pause_ends_ns + FORGOTTEN_AFTER_NS:
            record.pause_ns = FIRST_PAUSE_NS
        record.paused, record.missed = True, 0
        record.pause_ends_ns = now_ns + record.pause_ns
        record.pause_ns = min(2 * record.pause_ns, LONGEST_PAUSE_NS)
