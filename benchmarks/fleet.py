"""What a fleet costs whose workers are one pool: `python -m benchmarks.fleet --robots 10 [--own]`.

Simulated robots in the same hall behind one router, each with a bridge and a coordinator; with
`--own`, each with workers of its own. Measured once all robots are localized.
"""

import argparse
import os
import tempfile
import time
from collections import defaultdict
from contextlib import ExitStack
from pathlib import Path

import psutil
import zenoh
from msgspec.structs import replace

from benchmarks.memory import proportional_mb
from benchmarks.processor_time import in_between, processes_table, spent_by_thread
from clustermcl.link.session import open_session
from clustermcl.protocol import keys
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.codec import decode
from clustermcl.runtime.settings import (
    BridgeSettings,
    CoordinatorSettings,
    RobotSettings,
    Settings,
    ZenohSettings,
)
from clustermcl.runtime.stop import StopFlag
from tests.soak.fleet import Fleet


def fleet_settings(robots: int, folder: Path) -> list[Settings]:
    router = ZenohSettings(router=f"unixsock-stream/{folder}/router.sock")
    return [
        replace(
            Settings(),
            zenoh=router,
            seed=number,
            robot=RobotSettings(name=f"robot-{number}"),
            bridge=BridgeSettings(source="zenoh", gate_distance_m=0.0, gate_turn_rad=0.0),
            coordinator=CoordinatorSettings(state_folder="off"),
            worker=replace(Settings().worker, cache_folder=str(folder / "cache")),
        )
        for number in range(1, robots + 1)
    ]


def measure(options: argparse.Namespace, folder: Path) -> None:
    each = fleet_settings(options.robots, folder)
    fleet = Fleet(
        *(each, folder),
        world=options.world,
        rate_hz=options.rate,
        coordinators=1,
        pool=not options.own,
    )
    beliefs: dict[str, list[Belief]] = {one.robot.name: [] for one in each}
    fleet.start()
    try:
        with ExitStack() as opened:
            for one in each:

                def note(sample: zenoh.Sample, robot: str = one.robot.name) -> None:
                    beliefs[robot].append(decode(sample.payload.to_bytes(), Belief))

                opening = open_session(one.zenoh, one.robot, StopFlag(), wait_s=120.0)
                opened.enter_context(opening).declare_subscriber(keys.BELIEF, note)
            until_s = time.monotonic() + options.timeout
            while not all(has and has[-1].state == "localized" for has in beliefs.values()):
                fleet.poll()
                time.sleep(0.5)
                if time.monotonic() > until_s:
                    break
            localized = sum(bool(has) and has[-1].state == "localized" for has in beliefs.values())
            print(f"{localized} of {options.robots} robots localized")
            counts = {robot: len(has) for robot, has in beliefs.items()}
            before = spent_by_thread()
            time.sleep(options.seconds)
            spent = in_between(before, spent_by_thread())
            new = [belief for robot, has in beliefs.items() for belief in has[counts[robot] :]]
            sizes = defaultdict[str, list[float]](list)
            for part in fleet.parts():
                sizes[part.role].append(proportional_mb(part.process))
    finally:
        fleet.stop()
    steps = len(new)
    print(processes_table(spent, max(steps, 1)))
    missing = sum(bool(belief.missing) for belief in new)
    print(
        f"{steps / options.seconds:.1f} steps/s of all robots; {missing} without a report in time"
    )
    for role, sizes_mb in sorted(sizes.items()):
        print(f"{role}: {len(sizes_mb)} x {sum(sizes_mb) / len(sizes_mb):.1f} MB")
    print(f"{sum(map(sum, sizes.values())):.0f} MB in all; load {os.getloadavg()[0]:.1f}")
    print(f"{psutil.cpu_count()} cores")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--own", action="store_true", help="workers of their own, by need")
    parser.add_argument("--rate", type=float, default=0.4, help="steps a second of a robot")
    parser.add_argument("--world", default="hall")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--timeout", type=float, default=300.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="mcl-") as folder:
        measure(options, Path(folder))


if __name__ == "__main__":
    main()
