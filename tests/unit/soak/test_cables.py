"""A relay between this process and a router that records its messages."""

import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from tests.soak.cables import Relay, set_cables

QUIET_S, WITHIN_S = 0.2, 20.0


class Ends:
    """Of one link: sockets at the process's end and at the router's."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self._listen, self._control = folder / "cables", folder / "control"
        self._stack = stack
        self.router = stack.enter_context(socket.socket(socket.AF_UNIX))
        self.router.settimeout(WITHIN_S)
        self.router_path = folder / "router"
        self.router.bind(str(self.router_path))
        self.router.listen()
        self._relay = Relay(self._listen, self.router_path, self._control)
        stack.enter_context(closing(self._relay))
        self.own = self.call()
        self.far = self.answered()
        self.both_ways()

    def call(self) -> socket.socket:
        link = self._stack.enter_context(socket.socket(socket.AF_UNIX))
        link.settimeout(WITHIN_S)
        link.connect(str(self._listen))
        return link

    def answered(self) -> socket.socket:
        link = self._stack.enter_context(self.router.accept()[0])
        link.settimeout(WITHIN_S)
        return link

    def set(self, *, to_router: bool, from_router: bool) -> None:
        set_cables(self._control, [os.getpid()], to_router=to_router, from_router=from_router)
        self._relay.receive_command(WITHIN_S)

    def both_ways(self) -> None:
        self.own.sendall(b"a")
        assert self.far.recv(1) == b"a"
        self.far.sendall(b"b")
        assert self.own.recv(1) == b"b"


@pytest.fixture
def ends(tmp_path: Path) -> Iterator[Ends]:
    with ExitStack() as stack:
        yield Ends(tmp_path, stack)


def is_quiet(link: socket.socket) -> bool:
    """Whether nothing comes, and no end either."""
    link.settimeout(QUIET_S)
    try:
        link.recv(1)
    except TimeoutError:
        link.settimeout(WITHIN_S)
        return True
    return False


@pytest.mark.parametrize("to_router", [True, False])
def test_what_is_said_over_a_cut_cable_arrives_when_it_is_whole_again(
    ends: Ends, *, to_router: bool
) -> None:
    said, heard = (ends.own, ends.far) if to_router else (ends.far, ends.own)
    ends.set(to_router=not to_router, from_router=to_router)
    said.sendall(b"?")
    assert is_quiet(heard)
    heard.sendall(b"!")
    assert said.recv(1) == b"!", "the other direction is whole"
    ends.set(to_router=True, from_router=True)
    assert heard.recv(1) == b"?"
    ends.both_ways()


def test_a_closed_link_is_not_noticed_over_a_cut_cable(ends: Ends) -> None:
    ends.set(to_router=False, from_router=False)
    ends.own.close()
    assert is_quiet(ends.far)
    ends.set(to_router=True, from_router=True)
    assert ends.far.recv(1) == b""


def test_a_connection_over_a_cut_cable_succeeds_after_its_repair(ends: Ends) -> None:
    ends.set(to_router=False, from_router=True)
    link = ends.call()
    link.sendall(b"x")
    assert is_quiet(link)
    ends.set(to_router=True, from_router=True)
    assert ends.answered().recv(1) == b"x"


def test_a_link_that_the_router_ends_is_ended(ends: Ends) -> None:
    ends.far.close()
    assert ends.own.recv(1) == b""


def test_without_a_router_a_link_ends(ends: Ends) -> None:
    ends.router_path.unlink()
    assert ends.call().recv(1) == b""
