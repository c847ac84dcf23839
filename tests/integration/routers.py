"""Routers in the process of a test."""

import zenoh

from process_runtime.settings import ZenohSettings
from zenoh_link.configuration import as_zenoh, router_configuration
from zenoh_link.router import listen


def open_router(settings: ZenohSettings) -> zenoh.Session:
    """Listen at the settings' endpoint and forward between all who connect, until left."""
    return listen(as_zenoh(router_configuration(settings)), settings.router)
