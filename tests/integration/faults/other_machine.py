"""A second machine: a network namespace behind a cable that can be pulled."""

import os
import random
import shutil
import socket
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import pytest


@dataclass(frozen=True)
class OtherMachine:
    """A namespace with one cable to this machine."""

    namespace: str
    cable: str
    address_here: str
    """Where processes of the other machine find this one."""

    def command(self, words: Sequence[str]) -> list[str]:
        """The same command, over there."""
        return ["ip", "netns", "exec", self.namespace, *words]

    def pull_the_cable(self) -> None:
        """From now on packets vanish without a word, in both directions."""
        self._set_cable("down")

    def plug_it_in_again(self) -> None:
        self._set_cable("up")

    def _set_cable(self, state: str) -> None:
        # At the other end: here the address must stay, for processes of this machine use it too.
        _ip("netns", "exec", self.namespace, "ip", "link", "set", self.cable, state)


@contextmanager
def other_machine() -> Iterator[OtherMachine]:
    """Make one, or skip the test where that is not allowed."""
    if shutil.which("ip") is None or os.geteuid() != 0:
        pytest.skip("network namespaces need the command 'ip' and the rights of root")
    name = f"mcl{os.getpid()}x{random.randrange(1000)}"[:13]
    here, there = f"{name}a", f"{name}b"
    subnet = f"10.213.{random.randrange(256)}.{4 * random.randrange(64)}"
    first = int(subnet.rsplit(".", 1)[1])
    prefix = subnet.rsplit(".", 1)[0]
    address_here, address_there = f"{prefix}.{first + 1}", f"{prefix}.{first + 2}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False)
    if made.returncode != 0:
        pytest.skip(f"network namespaces cannot be made here: {made.stderr.strip()}")
    try:
        _ip("link", "add", here, "type", "veth", "peer", "name", there, "netns", name)
        _ip("addr", "add", f"{address_here}/30", "dev", here)
        _ip("link", "set", here, "up")
        _ip("netns", "exec", name, "ip", "addr", "add", f"{address_there}/30", "dev", there)
        _ip("netns", "exec", name, "ip", "link", "set", there, "up")
        _ip("netns", "exec", name, "ip", "link", "set", "lo", "up")
        yield OtherMachine(name, there, address_here)
    finally:
        _ip("netns", "del", name)  # and with it the cable


def free_port(address: str) -> int:
    """A port of an address that was free a moment ago."""
    with socket.create_server((address, 0)) as server:
        port: int = server.getsockname()[1]
        return port


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)
