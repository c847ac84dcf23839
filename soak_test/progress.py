"""What a person sees while a soak runs: every fault, and now and then how it goes."""

from typing import Protocol

from rich.console import Console

from soak_test.availability import DoneFault

_LINE_EVERY_S = 30.0


class Progress(Protocol):
    """Told how it goes."""

    def starting(self, ready: int, robots: int) -> None:
        """So many robots have found their first places."""

    def fault(self, fault: DoneFault, at_s: float) -> None:
        """A fault was done."""

    def going_on(self, elapsed_s: float, summary: str, faults: int) -> None:
        """The state of affairs, every second."""


class ConsoleProgress:
    """One line that changes on a terminal; a line every half minute elsewhere."""

    def __init__(self, console: Console, minutes: float) -> None:
        self._console, self._minutes = console, minutes
        self._status = console.status("starting") if console.is_terminal else None
        self._said_s = -_LINE_EVERY_S
        if self._status is not None:
            self._status.start()

    def starting(self, ready: int, robots: int) -> None:
        """So many robots have found their first places."""
        if self._status is not None:
            self._status.update(f"starting: {ready} of {robots} robots have found their places")

    def fault(self, fault: DoneFault, at_s: float) -> None:
        """A fault was done."""
        whom = " ".join(filter(None, (fault.robot, fault.target, fault.how)))
        lasts_s = (fault.until_ns - fault.at_ns) / 1e9
        lasts = f" for {lasts_s:.1f} s" if lasts_s else ""
        self._say(f"{at_s:7.1f} s  {fault.kind}{lasts}: {whom}")

    def going_on(self, elapsed_s: float, summary: str, faults: int) -> None:
        """The state of affairs, every second."""
        text = f"{elapsed_s / 60:.1f} of {self._minutes:g} min: {summary}, {faults} faults"
        if self._status is not None:
            self._status.update(text)
        elif elapsed_s - self._said_s >= _LINE_EVERY_S:
            self._said_s = elapsed_s
            self._say(text)

    def close(self) -> None:
        """Take the line that changes away."""
        if self._status is not None:
            self._status.stop()

    def _say(self, text: str) -> None:
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)
