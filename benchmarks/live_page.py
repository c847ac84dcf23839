"""Measures the page: CPU time and memory of its server, and the latency from a scan to a frame.

An imitated system publishes ten steps a second: scans, reports, beliefs, poses, answers. Run
``python -m benchmarks.live_page``; ``--browser`` also measures a real browser: the time until the
page is ready and a step is drawn, its memory, and the frame rate while the map is dragged.
``--side 16384`` shows a map with this number of cells a side, filled with copies of an office.
"""

import argparse
import json
import os
import re
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import msgspec
import numpy as np
import psutil
import zenoh
from websockets.sync.client import connect

from benchmarks.memory import offices, proportional_mb
from clustermcl.link.inbox import Inbox
from clustermcl.link.session import open_session
from clustermcl.link.wire import Asked, Publisher, serve
from clustermcl.protocol import keys
from clustermcl.protocol.answers import Belief, Hypothesis, PoseAnswer, Status
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.job_events import JobEvents
from clustermcl.protocol.steps import Scan, TruePose
from clustermcl.protocol.work import Particles, TrackReport
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.map_message import to_message
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.supervisor import python_module
from clustermcl.simulator.worlds.catalogue import world

STEPS_PER_S, SNAPSHOT_EVERY, PARTICLES, BEAMS = 10.0, 10, 2000, 180
COVARIANCE = (0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.001)


class Imitation:
    """A system with a number of clusters at the last step's places."""

    def __init__(self, session: zenoh.Session, clusters: int, drawn: GridMap) -> None:
        self._clusters, self._step = clusters, 0
        self._map = to_message(drawn, "bridge")
        self._put = {
            key: Publisher(session, key)
            for key in (keys.SCAN, keys.TRUTH, keys.BELIEF, keys.POSE, keys.worker_report("w-0"))
        }
        self._inbox: Inbox[Any] = Inbox({})
        for key in (keys.STATUS, keys.MAP, keys.EVENTS, keys.POSE):
            serve(session, key, self._inbox)
        self._ranges = ArrayBlob.of(np.random.default_rng(0).uniform(1, 8, BEAMS), "float32")
        self.sent_ns: dict[int, int] = {}

    def step(self) -> None:
        """One step: the scan first, the belief of it at once."""
        step, pose = self._step, (0.01 * self._step % 4.0, 0.0, 0.0)
        self.sent_ns[step] = time.monotonic_ns()
        self._put[keys.SCAN].put(
            Scan(
                sender="bridge", step=step, stamp_ns=step, odom_from_robot=pose,
                robot_from_laser=(0.0, 0.0, 0.0), angle_min_rad=-1.57,
                angle_step_rad=3.14 / BEAMS, range_max_m=10.0, ranges=self._ranges,
                map_digest=self._map.digest,
            )
        )  # fmt: skip
        self._put[keys.TRUTH].put(TruePose(sender="s", step=step, pose=pose))
        for cluster in range(self._clusters):
            self._put[keys.worker_report("w-0")].put(self._report(step, cluster))
        self._put[keys.BELIEF].put(self._belief(step, pose))
        self._put[keys.POSE].put(self._pose(step, pose))
        self._step += 1

    def answer(self) -> None:
        """Queries received meanwhile."""
        while (asked := self._inbox.get(0.0)) is not None:
            match asked:
                case Asked(key=keys.STATUS):
                    asked.answer(self._status())
                case Asked(key=keys.MAP):
                    asked.answer(self._map)
                case Asked(key=keys.EVENTS):
                    asked.answer(JobEvents(sender="c", events=(), term=1))
                case Asked():
                    asked.answer(self._pose(self._step, (0.0, 0.0, 0.0)))

    def _hypothesis(self, cluster: int, pose: tuple[float, float, float]) -> Hypothesis:
        share = 1.0 / self._clusters
        return Hypothesis(
            cluster=cluster, probability=share, log_probability=float(np.log(share)),
            pose=(pose[0] + 0.1 * cluster, pose[1], pose[2]), covariance=COVARIANCE,
            effective_sample_size=100.0, age_steps=self._step,
        )  # fmt: skip

    def _belief(self, step: int, pose: tuple[float, float, float]) -> Belief:
        return Belief(
            sender="c", step=step, stamp_ns=step, odom_from_robot=pose, state="ambiguous",
            hypotheses=tuple(self._hypothesis(one, pose) for one in range(self._clusters)),
            searching=False, term=1,
        )  # fmt: skip

    def _pose(self, step: int, pose: tuple[float, float, float]) -> PoseAnswer:
        return PoseAnswer(
            sender="c", state="ambiguous", freshness="fresh", stamp_ns=step, age_s=0.0, step=step,
            probability=0.25, pose=pose, covariance=COVARIANCE, workers=1, term=1,
        )  # fmt: skip

    def _report(self, step: int, cluster: int) -> TrackReport:
        snapshot = None
        if (step - cluster) % SNAPSHOT_EVERY == 0:
            poses = np.random.default_rng(step).normal(0.0, 0.1, (PARTICLES, 3))
            snapshot = Particles(
                step=step, odom_from_robot=(0.0, 0.0, 0.0),
                map_from_robot=ArrayBlob.of(poses, "float64"),
                log_weights=ArrayBlob.of(np.zeros(PARTICLES), "float64"),
            )  # fmt: skip
        return TrackReport(
            sender="w-0", job_id=f"c{cluster}", epoch=1, step=step, log_weight_sum=0.0,
            particles=PARTICLES, effective_sample_size=1.0,
            pose=(0.0, 0.0, 0.0), covariance=COVARIANCE, snapshot=snapshot,
        )  # fmt: skip

    def _status(self) -> Status:
        return Status(
            sender="c", version="1", state="ambiguous", freshness="fresh", age_s=0.0,
            step=self._step, steps_applied=self._step, steps_lost=0, reports_missing=0,
            map_digest=self._map.digest, clusters=self._clusters, searching=False,
            workers={"w-0": tuple(f"c{i}" for i in range(self._clusters))}, counters={},
            uptime_s=1.0, term=1,
        )  # fmt: skip


class Page:
    """An open page that draws in no time; notes when each step came."""

    def __init__(self, link: str) -> None:
        self.came_ns: dict[int, int] = {}
        self._socket = connect(f"ws{link.removeprefix('http')}live", origin=link.rstrip("/"),
                               proxy=None, max_size=None)  # fmt: skip
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        drawn = 0
        for data in self._socket:
            came_ns = time.monotonic_ns()
            drawn += 1
            if drawn == 3:  # as the page does
                self._socket.send('{"type": "drawn", "count": 3}')
                drawn = 0
            if b'"step":{' in (data if isinstance(data, bytes) else data.encode()):
                self.came_ns.setdefault(json.loads(data)["step"]["step"], came_ns)


@contextmanager
def running(*command: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--clusters", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--pages", type=int, nargs="*", default=[0, 1, 20])
    parser.add_argument("--browser", action="store_true")
    parser.add_argument("--side", type=int, default=0, help="cells of the map; 0: a small world")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, ExitStack() as resources:
        router = f"zenoh.router=unixsock-stream/{folder}/r.sock"
        resources.enter_context(running(*python_module("clustermcl.link.router", "--set", router)))
        view = resources.enter_context(
            running(*python_module("clustermcl.view", "--set", router, "--listen", "127.0.0.1:0"))
        )
        assert view.stderr is not None
        link = next(m[1] for line in view.stderr if (m := re.search(r"look at (\S+)", line)))
        settings = Settings()
        zenoh_settings = msgspec.structs.replace(settings.zenoh, router=router.partition("=")[2])
        session = resources.enter_context(
            open_session(zenoh_settings, settings.robot, StopFlag(), wait_s=10.0)
        )
        drawn = offices(arguments.side) if arguments.side else world("cross").map
        system = Imitation(session, arguments.clusters, drawn)
        for pages in arguments.pages:
            opened = [Page(link) for _ in range(pages - len(OPENED))]
            OPENED.extend(opened)
            measure(system, psutil.Process(view.pid), arguments.seconds, pages)
        if arguments.browser:
            in_browser(system, link, arguments.seconds)


OPENED: list[Page] = []


def play(system: Imitation, seconds: float) -> None:
    """Steps at their times."""
    begun_s = time.monotonic()
    for number in range(int(seconds * STEPS_PER_S)):
        system.step()
        while (left_s := begun_s + (number + 1) / STEPS_PER_S - time.monotonic()) > 0.0:
            system.answer()
            time.sleep(min(left_s, 0.02))


def measure(system: Imitation, server: psutil.Process, seconds: float, pages: int) -> None:
    play(system, 4.0)  # the map is fetched, everything has run once
    used = server.cpu_times()
    system.sent_ns.clear()
    begun_s = time.monotonic()
    play(system, seconds)
    wall_s, now = time.monotonic() - begun_s, server.cpu_times()
    cpu = (now.user + now.system - used.user - used.system) / wall_s
    mb, own_mb = server.memory_info().rss / 1e6, proportional_mb(server)
    line = f"{pages:2} pages: {100 * cpu:.2f} % of a core, {mb:.0f} MB ({own_mb:.0f} MB PSS)"
    line += f", load {os.getloadavg()[0]:.1f}"
    late_ms = [
        (page.came_ns[step] - sent) / 1e6
        for page in OPENED
        for step, sent in system.sent_ns.items()
        if step in page.came_ns
    ]
    print(f"{line}; scan to frame {quantiles(late_ms)}" if late_ms else line, flush=True)


def quantiles(late_ms: list[float]) -> str:
    middle, most = np.percentile(late_ms, [50, 95])
    return f"p50 {middle:.1f} ms, p95 {most:.1f} ms of {len(late_ms)}"


READY = """
const done = arguments[0];
const look = () => (window.liveView?.view.step && liveView.view.map)
  ? requestAnimationFrame(() => done(performance.now())) : setTimeout(look, 5);
look();
"""
NOTE_WHAT_IS_PAINTED = """
window.painted = {};
const view = liveView.view, draw = view.draw;
view.draw = function () {
  draw.call(view);
  const step = view.step?.step;
  if (step !== undefined) painted[step] ??= performance.timeOrigin + performance.now();
};
"""


DRAG = """
const done = arguments[0], view = liveView.view, late = [];
const begun = performance.now();
let right = 4;
const next = () => {
  const before = performance.now();
  if (late.length % 50 === 49) right = -right;
  view.pan(right, 1);
  view.draw();
  late.push(performance.now() - before);
  if (performance.now() - begun < 3000) requestAnimationFrame(next);
  else done([late.length / 3, Math.max(...late)]);
};
view.fit();
view.zoom(arguments[1]);
next();
"""


def in_browser(system: Imitation, link: str, seconds: float) -> None:
    """From the scan to the step on the screen, by a frame that the browser has painted."""
    from tests.integration.view.conftest import started_browser  # noqa: PLC0415 - an extra

    driver = started_browser()
    try:
        empty_mb = browser_mb(driver)
        player = threading.Thread(target=play, args=(system, seconds + 8.0))
        player.start()
        driver.get(link)
        print(f"page ready after {driver.execute_async_script(READY):.0f} ms")
        driver.execute_script(NOTE_WHAT_IS_PAINTED)
        epoch_ms = time.time() * 1e3 - time.monotonic_ns() / 1e6
        player.join()
        painted = driver.execute_script("return painted")
        late_ms = [at - epoch_ms - system.sent_ns[int(step)] / 1e6 for step, at in painted.items()]
        print(f"scan to picture in a browser {quantiles(late_ms)}")
        print(f"the browser: {empty_mb:.0f} MB empty, {browser_mb(driver):.0f} MB with the page")
        for zoom in (1.0, 8.0):
            per_s, most_ms = driver.execute_async_script(DRAG.replace("arguments[1]", str(zoom)))
            print(
                f"dragged, zoomed {zoom:g} times: {per_s:.0f} frames/s, none over {most_ms:.0f} ms"
            )
    finally:
        driver.quit()


def browser_mb(driver: Any) -> float:
    """Of all its processes, a page that they share counted once."""
    return sum(map(proportional_mb, psutil.Process(driver.service.process.pid).children(True)))


if __name__ == "__main__":
    main()
