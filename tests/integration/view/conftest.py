"""A robot's system, the page's process, and a browser that looks at it."""

import importlib.util
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from clustermcl.client import Client
from clustermcl.commands.stack import Stack, meeting_in
from clustermcl.runtime.supervisor import python_module
from tests.integration.free_port import free_port
from tests.integration.processes import RunningProcess
from tests.integration.system.conftest import SMALL
from tests.integration.view.page import Page
from tests.integration.waiting import patient_client

BROWSERS = ("chromium", "chromium-browser", "google-chrome")


class System:
    """A simulated robot in a cross of four equal arms, which can be ended and started again."""

    def __init__(self, folder: Path) -> None:
        changed = {
            "bridge": replace(SMALL.bridge, source="sim:cross", rate=2.0),
            "coordinator": replace(SMALL.coordinator, state_folder="off"),
            "worker": replace(SMALL.worker, count=2, cache_folder=str(folder / "cache")),
        }
        self.settings = meeting_in(folder, patient_client(replace(SMALL, **changed)))
        self._folder = folder
        self._stack: Stack | None = None

    def start(self) -> None:
        if self._stack is not None:
            return
        self._stack = Stack(self.settings, self._folder, logs_in_folder=True)
        self._stack.start_all()

    def stop(self) -> None:
        if self._stack is not None:
            self._stack.close()
            self._stack = None

    def causes(self) -> list[str]:
        with Client(self.settings) as client:
            return [numbered.event.cause for numbered in client.events().events]


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    """For a socket: its path has at most 107 bytes."""
    with tempfile.TemporaryDirectory(prefix="mcl-") as made:
        yield Path(made)


@pytest.fixture(scope="module")
def system(folder: Path) -> Iterator[System]:
    made = System(folder)
    yield made
    made.stop()


@pytest.fixture(scope="module")
def link(folder: Path, system: System) -> Iterator[str]:
    with ExitStack() as ended:
        endpoint = f"zenoh.router={system.settings.zenoh.router}"
        listen = f"127.0.0.1:{free_port()}"
        command = python_module("clustermcl.view", "--set", endpoint, "--listen", listen)
        process = RunningProcess(command, folder, "view")
        ended.callback(process.kill)
        process.wait_for("look at")
        yield f"http://{listen}/"


@pytest.fixture(scope="module")
def page(link: str, driver: Any) -> Page:
    return Page(driver, link)


@pytest.fixture(scope="session")
def driver() -> Iterator[Any]:
    with ExitStack() as ended:
        made = started_browser()
        ended.callback(made.quit)
        yield made


def started_browser() -> Any:
    """A browser and what drives it; skips where one of them is not installed.

    With BROWSER_TESTS=required it fails instead.
    """
    leave_out = pytest.fail if os.environ.get("BROWSER_TESTS") == "required" else pytest.skip
    if importlib.util.find_spec("selenium") is None:
        leave_out("selenium is not installed: pip install --group browser")
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    driver = shutil.which("chromedriver")
    if browser is None or driver is None:
        leave_out("no Chromium with its driver: apt-get install chromium chromium-driver")
    from selenium import webdriver  # noqa: PLC0415 - an extra
    from selenium.webdriver.chrome.service import Service  # noqa: PLC0415 - an extra

    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for argument in (
        "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--no-proxy-server",
        "--disable-background-networking", "--window-size=1360,900",
    ):  # fmt: skip
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    return webdriver.Chrome(options=options, service=Service(driver))
