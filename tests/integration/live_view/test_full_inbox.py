"""A page that floods the server with requests does not delay the server's own queries."""

from msgspec.structs import replace

from live_view.live_loop import LiveLoop
from process_runtime.settings import Settings, ZenohSettings
from tests.integration.conftest import OpenClient
from tests.integration.waiting import wait_until
from zenoh_link.wire import Received


def test_the_map_is_asked_for_again_although_the_inbox_is_full(
    router: ZenohSettings, open_client: OpenClient
) -> None:
    """An answer was lost in a full inbox, and the map was never requested."""
    loop = LiveLoop(replace(Settings(), zenoh=router), {})
    loop._session = open_client()
    flood, waiting = Received("nothing", b""), 0
    while loop._inbox.put(flood):
        waiting += 1
    loop._ask_what_is_due()
    assert loop._asking_map
    wait_until(lambda: len(loop._inbox._events.queue) >= waiting + 2, 20.0)  # status and map
    while loop._asking_map:
        event = loop._inbox.get(0.0)
        assert event is not None
        loop._on_event(event)
