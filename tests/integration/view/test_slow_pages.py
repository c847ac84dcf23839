import json
from contextlib import suppress
from typing import Any

from websockets.exceptions import ConnectionClosed

from tests.integration.view.page import opened
from tests.integration.view.stage import Stage
from tests.integration.waiting import wait_until
from tests.unit.view.messages import belief

STEPS, PLACES = 1000, 16


def test_a_page_that_requests_and_never_reads_is_disconnected_and_delays_no_other() -> None:
    with Stage() as stage:
        for step in range(STEPS):
            stage.picture.on_belief(belief(step, *range(PLACES)))
        with opened(stage.server.link, max_queue=1, ping_interval=None) as deaf:

            def asked_for_more() -> bool:
                stage.pump()
                try:
                    deaf.send('{"type": "earlier", "before": 1000}')
                    deaf.send('{"type": "drawn", "count": 100}')
                except ConnectionClosed:
                    return True
                return False

            wait_until(asked_for_more)
        with opened(stage.server.link, max_size=None) as other:
            reported: dict[str, Any] = {}

            def has_newest_step() -> bool:
                stage.pump()
                with suppress(TimeoutError):
                    reported.update(json.loads(other.recv(0.05)))
                return "step" in reported

            wait_until(has_newest_step)
            assert reported["step"]["step"] == STEPS - 1
