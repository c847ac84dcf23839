"""The real server and page without a system; tests give it what it should draw."""

import queue
import zlib
from typing import Self

import numpy as np
from msgspec.structs import replace

from clustermcl.protocol.steps import Landmark
from clustermcl.view.admission import parsed_address
from clustermcl.view.browser import FromBrowser
from clustermcl.view.commands import Command
from clustermcl.view.live_loop import answer_browser
from clustermcl.view.page_server import PageServer
from clustermcl.view.picture import Picture
from tests.unit.view.messages import map_message


class Stage:
    """A robot ``r`` and the server of its page: tests change `picture`, and call `pump`."""

    def __init__(self) -> None:
        self.picture = Picture({"robot": "r", "router": "none", "commands": True})
        self.picture.on_link("running")
        self.commands: list[Command] = []
        self._events: queue.Queue[FromBrowser] = queue.Queue()
        address = parsed_address("127.0.0.1:0")
        self.server = PageServer(address, self.picture, self._events.put, obeys_commands=True)

    def __enter__(self) -> Self:
        self.server.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self.server.__exit__(*error)

    def show_map(
        self,
        rows: int,
        cols: int,
        *,
        pillar: tuple[int, int] = (0, 0),
        landmarks: tuple[Landmark, ...] = (),
    ) -> None:
        """An empty room of this size, in cells of 0.05 m, but for a pillar of one cell."""
        cells = np.zeros((rows, cols), np.int8)
        cells[[0, -1]] = cells[:, [0, -1]] = cells[pillar] = 1
        packed, made = zlib.compress(cells.tobytes(), 1), map_message(f"{rows}x{cols}")
        size = {"rows": rows, "cols": cols, "cell_m": 0.05}
        self.picture.on_map(replace(made, **size, zlib_cells=packed, landmarks=landmarks))

    def pump(self) -> None:
        while not self._events.empty():
            event = self._events.get()
            if isinstance(event.request, Command):
                self.commands.append(replace(event.request, sender="view"))
            answer_browser(self.server, self.picture, event)
        if changes := self.picture.changes():
            self.server.publish(changes)
