"""All processes of a soak: one router, and for each robot all that `clustermcl up` starts."""

import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import psutil

from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_table import settings_as_toml
from clustermcl.runtime.supervisor import ChildExit, ChildSpec, Supervisor, python_module
from tests.maps import write_map
from tests.soak.eight_rooms import soak_world

ROUTER, WORKERS, COORDINATOR, BRIDGE, ROBOT = "router", "workers", "coordinator", "bridge", "robot"
POOL = "pool"
WORKER = "worker"
"""A process forked by the workers' parent."""


@dataclass(frozen=True)
class Part:
    robot: str
    """Empty for the router."""
    role: str
    name: str
    """Unique: ``robot-1/worker-3``."""
    process: psutil.Process

    @property
    def own_name(self) -> str:
        """Name without the robot: ``worker-3``."""
        return self.name.rpartition("/")[2]


class Fleet:
    """Starts the processes, restarts dead ones, ends them."""

    def __init__(
        self,
        settings: Sequence[Settings],
        folder: Path,
        *,
        world: str,
        rate_hz: float,
        coordinators: int,
        pool: bool = False,
    ) -> None:
        self._folder = folder
        self.exits: list[tuple[int, ChildExit]] = []
        children = list[ChildSpec]()
        grid_map = soak_world(world).map
        for one in settings:
            robot = one.robot.name
            map_file = write_map(grid_map, folder, f"{robot}-map")
            bridge = msgspec.structs.replace(one.bridge, map=str(map_file))
            own = msgspec.structs.replace(one, bridge=bridge)
            file = folder / f"{robot}.toml"
            file.write_text(settings_as_toml(own), "utf-8")
            if not children:
                children.append(self._child(ROUTER, "clustermcl.link.router", file))
            drive = ("--world", world, "--rate-hz", repr(rate_hz))
            if pool:
                (folder / POOL).mkdir(exist_ok=True)
                shutil.copy(file, folder / POOL)
            else:
                children.append(self._child(f"{robot}/{WORKERS}", "worker", file))
            children += [
                *self._coordinators(robot, file, coordinators),
                self._child(f"{robot}/{BRIDGE}", "sensor_bridge", file),
                self._child(f"{robot}/{ROBOT}", "tests.soak.driver", file, *drive),
            ]
        if pool:
            words = ("--fleet", str(folder / POOL), "--name", POOL)
            children.append(self._child(f"{POOL}/{WORKERS}", "worker", file, *words))
        self._children, self._supervisor = children, Supervisor()

    def start(self) -> None:
        for child in self._children:
            self._supervisor.add(child)

    def poll(self) -> None:
        for ended in self._supervisor.poll(time.monotonic()):
            self.exits.append((time.time_ns(), ended))

    def parts(self) -> list[Part]:
        names = {pid: name for name, pid in self._supervisor.pids().items()}
        found = []
        for process in self.processes():
            name = names.get(process.pid) or _worker_name(process, names)
            if name is not None:
                robot, _, own = name.rpartition("/")
                role = own.partition("-")[0]
                found.append(Part(robot, role, name, process))
        return found

    def processes(self) -> list[psutil.Process]:
        return psutil.Process().children(recursive=True)

    def stop(self) -> float:
        begin_s = time.monotonic()
        self._supervisor.stop()
        return time.monotonic() - begin_s

    def log_files(self) -> list[Path]:
        return sorted(self._folder.glob("*.log"))

    def _coordinators(self, robot: str, file: Path, count: int) -> list[ChildSpec]:
        names = [COORDINATOR, *(f"{COORDINATOR}-{number}" for number in range(2, count + 1))]
        waits = ("--standby",) if count > 1 else ()
        return [
            self._child(f"{robot}/{name}", "coordinator", file, "--name", name, *waits)
            for name in names
        ]

    def _child(self, name: str, module: str, file: Path, *arguments: str) -> ChildSpec:
        command = python_module(module, "--settings", str(file), *arguments)
        return ChildSpec(name, command, self._folder / f"{name.replace('/', '-')}.log")


def _worker_name(process: psutil.Process, names: dict[int, str]) -> str | None:
    """Return a forked worker's name, such as ``worker-3``; None for other or ending processes."""
    try:
        parent = names.get(process.ppid(), "")
        # `Process.name` would extend it by the command line, which all workers share.
        own = (Path("/proc") / str(process.pid) / "comm").read_text("utf-8").strip()
    except (psutil.NoSuchProcess, OSError):
        return None
    robot, _, role = parent.rpartition("/")
    return (
        f"{robot}/{own}" if role == WORKERS and own.startswith((f"{WORKER}-", f"{POOL}-")) else None
    )
