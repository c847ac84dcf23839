"""A process like all of ours: it waits for the router, subscribes, and prints messages."""

from clustermcl.link.session import open_session
from clustermcl.runtime.main import Invocation, process_main


def body(invocation: Invocation) -> None:
    received: list[str] = []
    settings = invocation.settings
    with open_session(settings.zenoh, settings.robot, invocation.stop, wait_s=None) as session:
        session.declare_subscriber("test", lambda s: received.append(s.payload.to_string()))
        print("subscribed", flush=True)
        while not invocation.stop.wait(0.01):
            while received:
                print(f"heard {received.pop(0)}", flush=True)
    print("closed", flush=True)


if __name__ == "__main__":
    process_main("client", body, describe="Test client.")
