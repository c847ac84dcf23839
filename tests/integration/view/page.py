"""What a test sees of the page, and does on it."""

import importlib.util
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import ClientConnection, connect

from tests.integration.waiting import PATIENCE_S, wait_until


def opened(link: str, **options: Any) -> ClientConnection:
    origin: Any = link.rstrip("/")
    return connect(f"ws{link[4:]}live", origin=origin, proxy=None, **options)


def frames(page: ClientConnection) -> Iterator[dict[str, Any]]:
    """Yield frames as they arrive; each is acknowledged, as a browser does."""
    while True:
        received = page.recv(PATIENCE_S)
        page.send('{"type": "drawn"}')
        yield json.loads(received)


def frame_of(page: ClientConnection, topic: str) -> dict[str, Any]:
    found: dict[str, Any] = next(each[topic] for each in frames(page) if topic in each)
    return found


class Page:
    def __init__(self, driver: Any, link: str) -> None:
        self.driver, self.link = driver, link
        driver.get("about:blank")  # an earlier page goes on looking for its server
        self.console()
        driver.get(link)

    def actions(self) -> Any:
        from selenium.webdriver.common.action_chains import ActionChains  # noqa: PLC0415 - extra

        return ActionChains(self.driver)

    def run(self, script: str) -> Any:
        return self.driver.execute_script(script)

    @property
    def system(self) -> str:
        visible: str = self.run("return document.documentElement.dataset.link ?? ''")
        return visible

    def run_async(self, script: str) -> Any:
        """What a script gives to ``done``."""
        return self.driver.execute_async_script(f"const done = arguments[0]; {script}")

    def text(self, element: str) -> str:
        visible: str = self.run(f"return document.getElementById('{element}').innerText")
        return visible

    def is_visible(self, element: str) -> bool:
        seen = "checkVisibility({checkVisibilityCSS: true})"
        shown: bool = self.run(f"return document.getElementById('{element}').{seen}")
        return shown

    def click(self, element: str) -> None:
        self.driver.find_element("id", element).click()

    def drag_on_map(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press, drag and release on the map's canvas [px from its corner]."""
        chain = self._at(start).click_and_hold()
        chain.move_by_offset(round(end[0] - start[0]), round(end[1] - start[1])).release().perform()

    def hover_on_map(self, where: tuple[float, float]) -> None:
        """Point at a place of the map's canvas [px from its corner]."""
        self._at(where).perform()

    def _at(self, where: tuple[float, float]) -> Any:
        canvas = self.driver.find_element("id", "map")
        width, height = canvas.rect["width"], canvas.rect["height"]
        x, y = round(where[0] - width / 2), round(where[1] - height / 2)
        return self.actions().move_to_element_with_offset(canvas, x, y)

    @contextmanager
    def on_screen(self, screen: str, scheme: str = "") -> Iterator[None]:
        """In a ``dark`` window, or in one of ``WIDTHxHEIGHT``, ``dark`` or not."""
        command = self.driver.execute_cdp_cmd
        if "dark" in (screen, scheme):
            dark = {"name": "prefers-color-scheme", "value": "dark"}
            command("Emulation.setEmulatedMedia", {"features": [dark]})
        if "x" in screen:
            width, height = map(int, screen.split("x"))
            size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            command("Emulation.setDeviceMetricsOverride", size)
        try:
            yield
        finally:
            command("Emulation.clearDeviceMetricsOverride", {})
            command("Emulation.setEmulatedMedia", {"features": []})

    def history(self) -> list[Any]:
        """Steps that the page knows: step, places, truth."""
        rows: list[Any] = self.run("return liveView.history()")
        return rows

    def places(self) -> list[dict[str, Any]]:
        """The places of the shown step."""
        places: list[dict[str, Any]] = self.run("return liveView.view.step?.places ?? []")
        return places

    def section(self) -> dict[str, float]:
        """The visible section: its middle [m], and pixels per metre."""
        section: dict[str, float] = self.run("return liveView.view.view")
        return section

    def screen_of(self, x_m: float, y_m: float) -> tuple[float, float]:
        left, top = self.run(f"return liveView.view.screenOf([{x_m}, {y_m}])")
        return left, top

    def pixel_at(self, x_m: float, y_m: float) -> tuple[int, int, int]:
        """The colour of a point of the map, drawn now."""
        red, green, blue = self.run(f"""
            const {{view}} = liveView, {{canvas}} = view;
            view.draw();
            const ratio = canvas.width / canvas.clientWidth; // of a phone's fine screen
            const at = view.screenOf([{x_m}, {y_m}]).map((px) => -Math.round(px * ratio));
            const copy = document.createElement("canvas").getContext("2d"); // read only once
            copy.drawImage(canvas, ...at);
            return [...copy.getImageData(0, 0, 1, 1).data].slice(0, 3);
        """)
        return red, green, blue

    def console(self) -> list[str]:
        return [entry["message"] for entry in self.driver.get_log("browser")]

    def wait_for_places(self, count: int, deadline_s: float = 90.0) -> None:
        probable = "return (liveView.view.step?.places ?? []).filter(one => one.p > 0.04).length"
        wait_until(lambda: self.run(probable) == count, deadline_s)


def press(page: Page, keys: str) -> None:
    page.actions().send_keys(keys).perform()


def problems(page: Page, *, serious: bool = False) -> list[str]:
    """What axe-core finds on the page by all its rules; or what breaks WCAG 2.1 AA seriously."""
    package = importlib.util.find_spec("axe_core_python")
    if package is None or package.origin is None:
        pytest.skip("axe-core-python is not installed: pip install --group browser")
    page.run((Path(package.origin).parent / "axe.min.js").read_text())
    rules = "{runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa']}" if serious else "{}"
    found = page.run_async(f"axe.run({rules}).then(done)")
    return [
        f"{violation['id']}: {[(n['html'][:90], n['any'][:1]) for n in violation['nodes'][:3]]}"
        for violation in found["violations"]
        if not serious or violation["impact"] in ("serious", "critical")
    ]
