"""Draws docs/page.webp: the live page in Chromium, of a real run.

    python docs/draw_page.py

Starts `clustermcl demo --view` and takes screenshots while the robot drives. Needs the group
`browser`, Chromium and its driver.
"""

import io
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from moving_picture import write_webp
from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.support.wait import WebDriverWait

STEPS = (*range(2, 132, 5), *range(132, 162, 2), *range(162, 193, 5))
"""Closer together while the robot sees the cabinet."""
WIDTH, HEIGHT = 1_080, 680
STEP_WITHIN_S = 60.0


def main() -> None:
    """Run it and write the file."""
    taken: list[Image.Image] = []
    with browser() as chromium, demo() as link:
        chromium.get(link)
        for step in STEPS:
            WebDriverWait(chromium, STEP_WITHIN_S, 0.05).until(shows(step))
            taken.append(Image.open(io.BytesIO(chromium.get_screenshot_as_png())))
    file = Path(__file__).with_name("page.webp")
    write_webp(file, taken, frame_ms=180, last_frame_ms=3_000, quality=75)


@contextmanager
def browser() -> Iterator[Any]:
    """Chromium without a screen."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for argument in ("--headless=new", "--no-sandbox", "--no-proxy-server", "--hide-scrollbars"):
        options.add_argument(argument)
    with webdriver.Chrome(options, Service(shutil.which("chromedriver"))) as chromium:
        size = {"width": WIDTH, "height": HEIGHT, "deviceScaleFactor": 1, "mobile": False}
        chromium.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        yield chromium


@contextmanager
def demo() -> Iterator[str]:
    """Start a demo in real time; yields the address of its page."""
    command = [sys.executable, "-I", "-m", "clustermcl", "demo", "--view", "--rate", "1"]
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stderr is not None
            links = (re.search(r"http://\S+", line) for line in process.stderr)
            yield next(link[0] for link in links if link)
        finally:
            process.terminate()


def shows(step: int) -> Any:
    """Whether the page has come as far as a step."""

    def reached(chromium: Any) -> bool:
        shown = chromium.execute_script("return document.getElementById('step').textContent")
        return shown.isdecimal() and int(shown) >= step

    return reached


if __name__ == "__main__":
    main()
