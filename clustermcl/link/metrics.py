"""Prometheus metrics on a local port, computed from the status message."""

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec

import zenoh

from clustermcl.link.wire import ask
from clustermcl.protocol import keys
from clustermcl.protocol.answers import Status
from clustermcl.protocol.errors import ClusterMclError, SettingsError
from clustermcl.runtime.settings import MetricsSettings

ASK_WITHIN_S = 1.0
RETRY_S = 2.0
"""Interval of attempts while another coordinator on this machine holds the port."""

_log = logging.getLogger(__name__)


@contextmanager
def metrics_served(
    settings: MetricsSettings, robot: str, session: Callable[[], zenoh.Session]
) -> Iterator[None]:
    """Serve ``/metrics`` within the block, if a port is set.

    Each scrape queries the status like any client: a loop that hangs shows as ``clustermcl_up 0``.
    While the port is in use the server logs it once and retries; localization continues.

    Raises:
        SettingsError: the port is set, but prometheus-client is not installed.
    """
    if settings.port == 0:
        yield
        return
    if find_spec("prometheus_client") is None:
        raise SettingsError(
            f"metrics.port = {settings.port} needs the library prometheus-client: "
            f"pip install 'clustermcl[metrics]'"
        )

    def status() -> Status | None:
        with suppress(ClusterMclError, zenoh.ZError):
            return ask(session(), keys.STATUS, Status, timeout_s=ASK_WITHIN_S)
        return None

    stop = threading.Event()
    server = threading.Thread(target=_serve, args=(settings, robot, status, stop), daemon=True)
    server.start()
    try:
        yield
    finally:
        stop.set()
        server.join(ASK_WITHIN_S)


def _serve(
    settings: MetricsSettings,
    robot: str,
    status: Callable[[], Status | None],
    stop: threading.Event,
) -> None:
    # An optional dependency.
    from prometheus_client import CollectorRegistry, start_http_server  # noqa: PLC0415 - see above

    from clustermcl.link.metrics_of_status import StatusCollector  # noqa: PLC0415 - see above

    registry = CollectorRegistry()
    registry.register(StatusCollector(status, robot))
    where = f"http://{settings.host}:{settings.port}/metrics"
    is_logged = False
    while not stop.is_set():
        try:
            server, _ = start_http_server(settings.port, settings.host, registry)
        except (OSError, UnicodeError) as error:  # UnicodeError: not a host name
            if not is_logged:
                _log.error("no metrics at %s: %s; trying again", where, error)
            is_logged = True
            stop.wait(RETRY_S)
            continue
        _log.info("metrics at %s", where)
        stop.wait()
        server.shutdown()
        server.server_close()
