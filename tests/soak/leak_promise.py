"""Promise: nothing leaks. Memory and open files do not grow."""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
import psutil
from scipy.stats import theilslopes

from tests.soak.promises import Break, Verdict

WARM_UP_S = 180.0
"""Time of a process in which caches and histories grow to their bounds. A worker's memory grows
by 3 MB in its first 100 to 160 s at 10 Hz, then stays constant."""
LEAST_SPAN_S = 600.0
"""Shortest observation of a process after its warm-up; growth over less may be bounded."""
APART_S = 60.0
"""Interval of samples [s]: samples within a minute are correlated."""
MEMORY_MB_PER_H, FILES_PER_H = 1.0, 5.0


@dataclass
class _Life:
    """One process in one role: standby and leader are separate roles."""

    begun_s: float
    times_s: list[float] = field(default_factory=list)
    memory_mb: list[float] = field(default_factory=list)
    files: list[float] = field(default_factory=list)


class NothingLeaks:
    """Samples of all processes, by name, process id and role."""

    def __init__(self) -> None:
        self._lives: dict[tuple[str, int, bool], _Life] = {}

    def sample(self, processes: Iterable[tuple[str, psutil.Process, bool]]) -> None:
        for name, process, leads in processes:
            try:
                with process.oneshot():
                    begun_s = process.create_time()
                    # USS, the memory of this process alone: its share of forked memory (PSS)
                    # changes with every sibling that ends.
                    memory_mb = process.memory_full_info().uss / 1e6
                    files = process.num_fds()
            except (psutil.NoSuchProcess, psutil.AccessDenied):
                continue
            now_s, key = time.time(), (name, process.pid, leads)
            if key not in self._lives:
                changed_role = (name, process.pid, not leads) in self._lives
                self._lives[key] = _Life(now_s if changed_role else begun_s)
            life = self._lives[key]
            if not life.times_s or now_s >= life.times_s[-1] + APART_S:
                life.times_s.append(now_s)
                life.memory_mb.append(memory_mb)
                life.files.append(float(files))

    def verdict(self) -> Verdict:
        """Return the verdict: broken only if the 95 % interval of a slope lies above the target.

        Over the whole life and over its second half: memory that has reached a bound, be it half
        an hour after the start, does not leak.
        """
        memory = self._slopes(lambda life: life.memory_mb)
        files = self._slopes(lambda life: life.files)
        leaks = [name for name, (_, at_least, _) in memory.items() if at_least > MEMORY_MB_PER_H]
        leaks += [f"{n}'s files" for n, (_, least, _) in files.items() if least > FILES_PER_H]
        return Verdict(
            promise="nothing leaks",
            kept=not leaks if memory else None,  # else no process ran for 13 minutes
            breaks=[Break(0, f"{name} grow") for name in leaks],
            figures={f"{name} MB per hour": each for name, (each, _, _) in memory.items()},
        )

    def _slopes(self, values: Callable[[_Life], list[float]]) -> dict[str, tuple[float, ...]]:
        """Return the slope per hour with its 95 % interval, for processes observed long enough.

        The interval's lower end is that of the second half of the life, where it is lower there.

        References:
            Sen (1968), Estimates of the regression coefficient based on Kendall's tau.
        """
        found: dict[str, tuple[float, ...]] = {}
        for (name, pid, _), life in self._lives.items():
            times_s = np.array(life.times_s)
            warm = times_s >= life.begun_s + WARM_UP_S
            if not warm.any() or np.ptp(times_s[warm]) < LEAST_SPAN_S:
                continue
            late = warm & (times_s >= (life.begun_s + times_s[-1]) / 2)
            slope, recent = (
                theilslopes(np.array(values(life))[part], times_s[part] / 3600.0)
                for part in (warm, late)
            )
            at_least = min(slope.low_slope, recent.low_slope)
            found[f"{name} ({pid})"] = slope.slope, at_least, slope.high_slope
        return found
