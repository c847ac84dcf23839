from contextlib import closing

from msgspec.structs import replace

from clustermcl.link.wire import Received
from clustermcl.runtime.settings import Settings, ZenohSettings
from clustermcl.runtime.stop import StopFlag
from clustermcl.view.live_loop import LiveLoop
from tests.integration.waiting import PATIENCE_S, wait_until


def test_the_map_is_asked_for_again_although_the_inbox_is_full(router: ZenohSettings) -> None:
    """An answer was lost in a full inbox, and the map was never requested."""
    loop = LiveLoop(replace(Settings(), zenoh=router), {}, StopFlag())
    with closing(loop.node) as node:
        node.open(PATIENCE_S)
        flood, waiting = Received("nothing", b""), 0
        while node.inbox.put(flood):
            waiting += 1
        loop._query_status_and_map()
        assert loop._asking_map
        own = 3  # the link, and that status and map are not answered
        wait_until(lambda: len(node.inbox._events.queue) >= waiting + own)
        for _ in range(len(node.inbox._events.queue)):
            event = node.inbox.get(0.0)
            if event is not flood:
                node.attempt(node._handle, event)
        assert not loop._asking_map
