"""Memory and open files of every process, sample by sample, and whether they grow."""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
import psutil

from soak_test.slope import Slope, robust_slope
from soak_test.verdict import Verdict

WARM_UP_S = 180.0
"""Of each life: caches fill, histories grow to their bound. A worker's memory rises by some 3 MB in
its first 100 to 160 s at 10 Hz, and stays."""
LEAST_SPAN_S = 600.0
"""In all, after the warm-ups; what grows over shorter times need not grow for ever."""
MEMORY_TARGET_MB_PER_H = 1.0
FILES_TARGET_PER_H = 5.0
_MB = 1e6
_SURE = 2.0
"""Standard errors."""


@dataclass
class Life:
    """One process as long as it does one thing: to stand by is another life than to act."""

    begun_s: float
    times_s: list[float] = field(default_factory=list)
    memory_mb: list[float] = field(default_factory=list)
    files: list[float] = field(default_factory=list)


class Resources:
    """Samples of all processes by the name of what they do; successors share the name."""

    def __init__(self) -> None:
        self.lives: dict[str, dict[tuple[int, float, bool], Life]] = {}
        """By name; of each by process id, when it was made, and whether it acts."""
        self.zombies: set[str] = set()
        """Dead processes that two samples in a row have seen."""
        self._dead: set[psutil.Process] = set()

    def sample(self, processes: Iterable[tuple[str, psutil.Process, bool]]) -> None:
        """Look at each process; one that ends meanwhile is left out.

        Args:
            processes: by name; with whether it is the coordinator that acts.
        """
        for name, process, acts in processes:
            try:
                with process.oneshot():
                    created_s = process.create_time()
                    # USS: what this process alone has. Shares of forked memory (PSS) change
                    # whenever a sibling dies.
                    memory_mb = process.memory_full_info().uss / _MB
                    files = process.num_fds()
            except (psutil.NoSuchProcess, psutil.AccessDenied):
                continue
            lives = self.lives.setdefault(name, {})
            now_s = time.time()
            is_first = (process.pid, created_s, not acts) not in lives
            begun_s = created_s if is_first else now_s
            life = lives.setdefault((process.pid, created_s, acts), Life(begun_s))
            life.times_s.append(now_s)
            life.memory_mb.append(memory_mb)
            life.files.append(float(files))

    def look_for_zombies(self, processes: Iterable[psutil.Process]) -> None:
        """Remember who was dead at the last look and has still not been reaped."""
        dead = {process for process in processes if _is_dead(process)}
        self.zombies |= {f"{process.pid}" for process in dead & self._dead}
        self._dead = dead

    def slope(self, name: str, values: Callable[[Life], list[float]]) -> Slope | None:
        """Growth over all processes of a name without their warm-ups; None: too short to tell."""
        kept = []
        for life in self.lives[name].values():
            times_s = np.array(life.times_s)
            warm = times_s >= life.begun_s + WARM_UP_S
            if warm.any():
                kept.append((times_s[warm], np.array(values(life))[warm]))
        if sum(float(np.ptp(times_s)) for times_s, _ in kept) < LEAST_SPAN_S:
            return None
        return robust_slope(kept)

    def verdicts(self) -> list[Verdict]:
        """On memory and on open files: of the process that grows fastest."""
        return [
            self._verdict(
                "no process grows", "MB", MEMORY_TARGET_MB_PER_H, lambda life: life.memory_mb
            ),
            self._verdict(
                "no process opens more and more files", "files", FILES_TARGET_PER_H,
                lambda life: life.files,
            ),
        ]  # fmt: skip

    def _verdict(
        self, promise: str, unit: str, target: float, values: Callable[[Life], list[float]]
    ) -> Verdict:
        slopes = {
            name: slope for name in self.lives if (slope := self.slope(name, values)) is not None
        }
        target_text = f"< {target:g} {unit} an hour"
        if not slopes:
            return Verdict(
                promise=promise, target=target_text, measured="under 10 minutes", kept=None
            )
        judged = {name: _judged(slope, target) for name, slope in slopes.items()}
        shown = sorted(slopes, key=lambda n: (judged[n] is not False, -slopes[n].per_hour))
        worst = slopes[shown[0]]
        known = None not in judged.values() and set(slopes) == set(self.lives)
        figures = {f"{name} per hour": slope.per_hour for name, slope in slopes.items()}
        figures |= {f"{name} error": slope.standard_error for name, slope in slopes.items()}
        return Verdict(
            promise=promise,
            target=target_text,
            measured=f"{shown[0]} {worst.per_hour:+.2f} ± {worst.standard_error:.2f}",
            kept=False if False in judged.values() else (True if known else None),
            figures=figures,
        )


def _judged(slope: Slope, target: float) -> bool | None:
    """Broken only where that is sure, kept only where the error is smaller than the target."""
    doubt = _SURE * slope.standard_error
    if slope.per_hour - doubt > target:
        return False
    return True if slope.per_hour <= target and doubt <= target else None


def _is_dead(process: psutil.Process) -> bool:
    try:
        return bool(process.status() == psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False
