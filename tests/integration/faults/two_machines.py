"""A second machine on this one: a network namespace at the other end of a cable."""

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import pytest


@dataclass(frozen=True)
class Cable:
    """Between this machine and the far one; it can be cut and slowed down."""

    here: str
    """Address of this machine at the cable."""
    there: str
    device: str
    namespace: str

    @property
    def over_there(self) -> tuple[str, ...]:
        """What a command of the far machine begins with."""
        return ("ip", "netns", "exec", self.namespace)

    @contextmanager
    def cut(self, *, from_here: bool, from_there: bool) -> Iterator[None]:
        """Drop all packets in these directions silently."""
        cuts = [((), self.there)] if from_here else []
        cuts += [(self.over_there, self.here)] if from_there else []
        for where, address in cuts:  # narrower than the cable's own route
            ran(*where, "ip", "route", "add", "blackhole", f"{address}/32")
        try:
            yield
        finally:
            for where, address in cuts:
                ran(*where, "ip", "route", "del", "blackhole", f"{address}/32")

    @contextmanager
    def shaped(self, *how: str) -> Iterator[None]:
        """Delay, drop or throttle packets to the far machine with `tc`."""
        try:
            ran("tc", "qdisc", "add", "dev", self.device, "root", *how)
        except (OSError, subprocess.CalledProcessError) as error:
            pytest.skip(f"no `tc {' '.join(how)}`: {getattr(error, 'stderr', error)}".strip())
        try:
            yield
        finally:
            ran("tc", "qdisc", "del", "dev", self.device, "root")


@contextmanager
def second_machine() -> Iterator[Cable]:
    """Lay the cable; skip the test, with the kernel's message, if that is not permitted."""
    name = f"mcl{os.getpid()}"
    subnet = f"10.215.{os.getpid() % 250}"
    cable = Cable(f"{subnet}.1", f"{subnet}.2", f"{name}a", name)
    try:
        ran("ip", "netns", "add", name)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no network namespace: {getattr(error, 'stderr', error)}".strip())
    try:
        peer = ("peer", "name", f"{name}b", "netns", name)
        ran("ip", "link", "add", cable.device, "type", "veth", *peer)
        for where, address, device in (
            ((), cable.here, cable.device),
            (cable.over_there, cable.there, f"{name}b"),
        ):
            ran(*where, "ip", "addr", "add", f"{address}/30", "dev", device)
            ran(*where, "ip", "link", "set", device, "up")
        yield cable
    finally:
        ran("ip", "netns", "del", name)


def ran(*command: str) -> str:
    done = subprocess.run(
        command, check=True, capture_output=True, text=True, stdin=subprocess.DEVNULL
    )
    return done.stdout
