"""How long a stack takes to start: `python -m benchmarks.start [--cold]`.

From `clustermcl up` to the first pose answered, warm (kernels compiled and fields computed) or
cold (neither); and how long `clustermcl pose` takes from its own start.
"""

import argparse
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence

import msgspec

from clustermcl.client import Client
from clustermcl.protocol.errors import ClusterMclError
from clustermcl.runtime.settings import Settings

COMMAND = (sys.executable, "-I", "-m", "clustermcl")


def first_pose_s(settings: Settings, words: Sequence[str], environment: dict[str, str]) -> float:
    """Seconds until a pose is answered by a coordinator that has a place for the robot."""
    start_s = time.monotonic()
    up = subprocess.Popen(
        [*COMMAND, "up", *words],
        env=environment,
        stderr=subprocess.DEVNULL,
        stdin=subprocess.DEVNULL,
    )
    try:
        while True:
            try:
                with Client(settings) as client:
                    while client.pose().step < 0:
                        time.sleep(0.02)
                    first_s = time.monotonic() - start_s
                    print(f"first pose answered: {first_s:.2f} s", flush=True)
                    while not client.pose().probability > 0.0:
                        time.sleep(0.02)
                    print(f"first place after {time.monotonic() - start_s:.2f} s", flush=True)
                break
            except ClusterMclError:
                time.sleep(0.02)
        for _ in range(3):
            asked_s = time.monotonic()
            subprocess.run(
                [*COMMAND, "pose", *words[:2]], env=environment, check=False, capture_output=True
            )
            print(f"clustermcl pose: {time.monotonic() - asked_s:.2f} s", flush=True)
        return first_s
    finally:
        up.send_signal(signal.SIGINT)
        up.wait(20)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cold", action="store_true", help="compile and compute everything again")
    parser.add_argument("--world", default="office")
    options = parser.parse_args()
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        router = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    settings = Settings()
    zenoh = msgspec.structs.replace(settings.zenoh, router=router)
    settings = msgspec.structs.replace(settings, zenoh=zenoh)
    words = ["--set", f"zenoh.router={router}", "--set", f"bridge.source=sim:{options.world}"]
    with tempfile.TemporaryDirectory() as folder:
        environment = dict(os.environ)
        if options.cold:
            environment |= {"NUMBA_CACHE_DIR": folder, "XDG_CACHE_HOME": folder}
        first_pose_s(settings, words, environment)
    print(f"load average {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
