"""A process whose loop hangs from SIGUSR1 on, while a thread of it goes on."""

import signal
import threading

from clustermcl.runtime.main import Invocation, process_main


def body(invocation: Invocation) -> None:
    hang, never = threading.Event(), threading.Event()
    signal.signal(signal.SIGUSR1, lambda *_: hang.set())
    threading.Thread(target=lambda: [None for _ in iter(lambda: never.wait(0.05), True)]).start()
    print("goes round", flush=True)
    while not invocation.stop.wait(0.1):
        if hang.is_set():
            print("hangs", flush=True)
            never.wait()


if __name__ == "__main__":
    process_main("hanging", body, describe="Test process.")
