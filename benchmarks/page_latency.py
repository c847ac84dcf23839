"""Measures whether a page delays the belief, in alternating blocks of steps with and without it.

A whole stack runs with a simulated robot, some ten steps a second. A client of the router measures
the time from scan to belief. ``python -m benchmarks.page_latency [--rounds N]``.
"""

import argparse
import itertools
import re
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import msgspec
import numpy as np
import zenoh

from benchmarks.live_page import Page, running
from clustermcl.commands.stack import Stack, meeting_in
from clustermcl.link.inbox import Inbox
from clustermcl.link.session import open_session
from clustermcl.link.wire import Events, Received, subscribe
from clustermcl.protocol import keys
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.codec import decode
from clustermcl.protocol.steps import Scan
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.supervisor import python_module

BEGINNING_STEPS = 60
"""Left out: the first search."""
SETTLED_STEPS = 10
"""Left out of each block: the page's process has just begun or ended."""
STEP_WITHIN_S = 60.0


class Listener:
    """Hears scans and beliefs."""

    def __init__(self, session: zenoh.Session) -> None:
        self._inbox: Events = Inbox({"scan": 1024, "belief": 1024})
        self._scans_ns: dict[int, int] = {}
        subscribe(session, keys.SCAN, Scan, self._inbox, "scan")
        subscribe(session, keys.BELIEF, Belief, self._inbox, "belief")

    def late_ms(self, steps: int) -> list[float]:
        """From scan to belief of the steps that come next."""
        late: list[float] = []
        while self._inbox.get(0.0) is not None:  # messages from before the measurement
            pass
        while len(late) < steps:
            match self._inbox.get(STEP_WITHIN_S):
                case Received(key=keys.SCAN, payload=payload, at_ns=at_ns):
                    self._scans_ns[decode(payload, Scan).step] = at_ns
                case Received(key=keys.BELIEF, payload=payload, at_ns=at_ns):
                    sent_ns = self._scans_ns.pop(decode(payload, Belief).step, None)
                    if sent_ns is not None:
                        late.append((at_ns - sent_ns) / 1e6)
                case None:
                    raise SystemExit(f"no step has come for {STEP_WITHIN_S:.0f} s")
        return late


@contextmanager
def opened_page(router: str) -> Iterator[None]:
    """The page's process, and a page that looks."""
    words = ("--set", f"zenoh.router={router}", "--listen", "127.0.0.1:0")
    with running(*python_module("clustermcl.view", *words)) as view:
        assert view.stderr is not None
        link = next(m[1] for line in view.stderr if (m := re.search(r"look at (\S+)", line)))
        page = Page(link)
        deadline_s = time.monotonic() + STEP_WITHIN_S
        while not page.came_ns:
            if time.monotonic() > deadline_s:
                raise SystemExit("the page shows no step")
            time.sleep(0.05)
        yield


def settings_in(folder: Path, world: str) -> Settings:
    """Of a robot that makes some ten steps a second."""
    settings = Settings()
    bridge = msgspec.structs.replace(settings.bridge, source=f"sim:{world}", rate=6.0)
    nothing_kept = msgspec.structs.replace(settings.coordinator, state_folder="off")
    changed = msgspec.structs.replace(settings, bridge=bridge, coordinator=nothing_kept)
    return meeting_in(folder, changed)


def measured(world: str, rounds: int, steps: int) -> tuple[list[list[float]], list[list[float]]]:
    """Milliseconds from scan to belief, block by block: without a page, and with one."""
    without, with_page = list[list[float]](), list[list[float]]()
    with tempfile.TemporaryDirectory() as name:
        settings = settings_in(Path(name), world)
        with closing(Stack(settings, Path(name), logs_in_folder=True)) as stack:
            stack.start_all()
            with open_session(
                settings.zenoh, settings.robot, StopFlag(), wait_s=STEP_WITHIN_S
            ) as session:
                listener = Listener(session)
                listener.late_ms(BEGINNING_STEPS)
                for _ in range(rounds):
                    without.append(listener.late_ms(SETTLED_STEPS + steps)[SETTLED_STEPS:])
                    with opened_page(settings.zenoh.router):
                        with_page.append(listener.late_ms(SETTLED_STEPS + steps)[SETTLED_STEPS:])
    return without, with_page


def report(without: list[list[float]], with_page: list[list[float]]) -> Iterator[str]:
    """The figures, and the difference with its standard error, of blocks that are neighbours."""
    for name, blocks in (("without a page", without), ("with a page", with_page)):
        late = np.array(list(itertools.chain(*blocks)))
        p50, p95 = np.percentile(late, [50, 95])
        yield f"{name}: p50 {p50:.2f} ms, p95 {p95:.2f} ms of {len(late)} steps"
    pairs = zip(without, with_page, strict=True)
    more = np.array([np.median(looked) - np.median(alone) for alone, looked in pairs])
    error = more.std(ddof=1) / np.sqrt(len(more)) if len(more) > 1 else float("nan")
    yield f"a page adds {more.mean():+.2f} ms to the median, standard error {error:.2f} ms"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--world", default="cross")
    parser.add_argument("--rounds", type=int, default=8, help="blocks of each kind")
    parser.add_argument("--steps", type=int, default=60, help="of each block")
    options = parser.parse_args()
    print("\n".join(report(*measured(options.world, options.rounds, options.steps))))


if __name__ == "__main__":
    main()
