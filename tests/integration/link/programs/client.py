"""A process like all of ours: it waits for the router, subscribes, and prints messages."""

import zenoh

from clustermcl.link.session import open_session
from clustermcl.runtime.main import Invocation, process_main


def body(invocation: Invocation) -> None:
    received: list[str] = []

    def on_sample(sample: zenoh.Sample) -> None:
        received.append(sample.payload.to_string())

    settings = invocation.settings
    print("starting", flush=True)
    with open_session(settings.zenoh, settings.robot, invocation.stop, wait_s=None) as session:
        session.declare_subscriber("test", on_sample)
        print("subscribed", flush=True)
        while not invocation.stop.wait(0.01):
            while received:
                text = received.pop(0)
                print(f"heard {text}", flush=True)
                if text == "crash":
                    raise ZeroDivisionError(text)
    print("closed", flush=True)


if __name__ == "__main__":
    process_main("client", body, describe="Test client.")
