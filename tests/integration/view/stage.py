"""The real server and page without a system; tests give it what it should draw."""

import queue
import zlib
from typing import Self

import numpy as np
from msgspec.structs import replace

from clustermcl.protocol.steps import Landmark, MapMessage
from clustermcl.view.admission import parsed_address
from clustermcl.view.commands import Command
from clustermcl.view.live_loop import answer_browser
from clustermcl.view.map_reduction import reduced
from clustermcl.view.page_server import PageServer
from clustermcl.view.picture import Picture
from clustermcl.view.room import FromBrowser, Room
from tests.unit.view.messages import map_message


class Actor:
    """A robot that pages may look at: tests change `picture`, and call `pump`."""

    def __init__(self, name: str, robots: list[str]) -> None:
        self.picture = Picture(
            {"robot": name, "router": "none", "commands": True, "robots": robots}
        )
        self.picture.on_link("running")
        self.commands: list[Command] = []
        self._events: queue.Queue[FromBrowser] = queue.Queue()
        self.room = Room(name, self._events.put)

    def pump(self) -> None:
        while not self._events.empty():
            event = self._events.get()
            if isinstance(event.request, Command):
                self.commands.append(replace(event.request, sender="view"))
            answer_browser(self.room, self.picture, event)
        if changes := self.picture.changes():
            self.room.publish(changes)


class Stage(Actor):
    """The robot ``r``, others by their names, and the server of their pages."""

    def __init__(self, *others: str) -> None:
        super().__init__("r", ["r", *others] if others else [])
        self.map: MapMessage | None = None
        self.others = {name: Actor(name, []) for name in others}
        rooms = [self.room, *(other.room for other in self.others.values())]
        self.server = PageServer(parsed_address("127.0.0.1:0"), rooms, obeys_commands=True)

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
        cell_m: float = 0.05,
        pillar: tuple[int, int] = (0, 0),
        landmarks: tuple[Landmark, ...] = (),
    ) -> None:
        """An empty room of this size, but for a pillar of one cell."""
        cells = np.zeros((rows, cols), np.int8)
        cells[[0, -1]] = cells[:, [0, -1]] = cells[pillar] = 1
        made = replace(
            map_message(f"{rows}x{cols}"), cell_m=cell_m, rows=rows, cols=cols, landmarks=landmarks
        )
        self.show(replace(made, zlib_cells=zlib.compress(cells.tobytes(), 1)))

    def show(self, grid_map: MapMessage) -> None:
        self.map = message = reduced(grid_map)
        self.room.map = (message.digest, message.zlib_cells)
        self.picture.on_map(message)

    def pump(self) -> None:
        for other in self.others.values():
            other.pump()
        super().pump()
