"""Routers in the process of a test."""

import zenoh

from clustermcl.link.configuration import as_zenoh, router_configuration
from clustermcl.link.router import listen
from clustermcl.runtime.settings import ZenohSettings


def open_router(settings: ZenohSettings) -> zenoh.Session:
    """Listen at the settings' endpoint and forward between all who connect, until left."""
    return listen(as_zenoh(router_configuration(settings)), settings.router)
