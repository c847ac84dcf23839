"""`clustermcl view`: the page that draws the clusters, until Ctrl-C."""

import sys
from importlib.util import find_spec

from live_view.admission import Address, parsed_address
from process_runtime.settings import Settings
from process_runtime.stop import stop_on_signals
from protocol.errors import ClusterMclError


class PageNotInstalledError(ClusterMclError):
    """What serves the page is an extra, and it is not there."""

    def __init__(self) -> None:
        self.package, self.extra = "websockets", "view"
        super().__init__(f"the page needs {self.package!r}: pip install 'clustermcl[{self.extra}]'")


def page_address(listen: str) -> Address:
    """Where the page is going to be served.

    Raises:
        PageNotInstalledError: what serves it is not installed.
        SettingsError: it is no address.
    """
    if find_spec("websockets") is None:
        raise PageNotInstalledError
    return parsed_address(listen)


def run_view(settings: Settings, *, listen: str, allow_commands: bool, open_browser: bool) -> None:
    """Serve the page; it waits for the system, and for its return.

    Raises:
        PageNotInstalledError: what serves it is not installed.
        SettingsError: the address cannot be used.
    """
    address = page_address(listen)
    from live_view.process import serve_page  # noqa: PLC0415 - needs the extra

    stop = stop_on_signals()
    serve_page(
        settings,
        stop,
        address,
        say=say_link,
        allow_commands=allow_commands,
        open_browser=open_browser,
    )


def say_link(link: str) -> None:
    """Tell a person what to open."""
    sys.stderr.write(f"clustermcl: look at {link}\n")
    sys.stderr.flush()
