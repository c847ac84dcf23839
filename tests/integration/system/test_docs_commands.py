"""Every block of commands in README and docs runs as it is printed, or says why no test runs it.

A comment before each block says which: `runs: offline`, in a folder with a map and a recording;
`runs: live`, with a robot to ask; `runs: ...` otherwise, elsewhere; `not run: why`.
"""

import os
import re
import runpy
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from clustermcl.evaluation.references import tum_line
from clustermcl.runtime.settings import BridgeSettings, CoordinatorSettings, Settings
from clustermcl.simulator.sensors import LidarModel
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.faults.system import system
from tests.integration.security.certificates import require_openssl
from tests.integration.system.commands import SMALL_FILTER
from tests.integration.system.conftest import SMALL
from tests.integration.waiting import PATIENCE_S, patient_client, wait_until
from tests.integration.worlds import write_room
from tests.maps import write_map
from tests.unit.recordings.logs import flaser

pytestmark = pytest.mark.timeout(300)  # a block is several commands

REPOSITORY = Path(__file__).parents[3]
PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]
EXAMPLES = REPOSITORY / "examples"
LONGEST_EXAMPLE = 30
ALONE = {
    "arrays": r"^\d+% at x 8.0 m, y 4.0 m$",
    "two_lasers": r"localized 2 lasers",
    "tags": r"localized \d places",
    "floors": r"localized: 100% on ",
}
"""What the examples print that need no robot."""
LIVE = {"planner": r"places, ambiguous|plan with|localized", "fleet": r"robot: \w+, \w+, \d+%"}
ELSEWHERE = {"test command", "driver", "robot example"}
"""Marks of blocks that .ci/run and other tests run: test_pages.py, test_live_robot.py, ..."""


@dataclass(frozen=True)
class Block:
    page: str
    mark: str
    language: str
    text: str

    def __str__(self) -> str:
        return f"{self.page}: {self.text.splitlines()[0].strip()}"


def blocks() -> list[Block]:
    fence = re.compile(
        r"(?:<!-- ([^\n]*?) -->\n)?^( *)```(bash|console|python)\n(.*?)^\2```", re.DOTALL | re.M
    )
    return [
        Block(page.name, mark, language, re.sub(f"^{indent}", "", text, flags=re.M))
        for page in PAGES
        for mark, indent, language, text in fence.findall(page.read_text())
    ]


def marked(mark: str, language: str = "bash") -> list[Block]:
    """Those with a mark; what stands on two pages is one."""
    found = [one for one in blocks() if (one.mark, one.language) == (f"runs: {mark}", language)]
    return list({one.text: one for one in found}.values())


def once(found: list[Block]) -> list[Block]:
    """Without the commands of one line that stood before, whatever is said of them there."""
    seen, left = set[str](), list[Block]()
    for block in found:
        lines = block.text.splitlines()
        if news := [line for line in lines if line.split(" #")[0].rstrip() not in seen]:
            left.append(replace(block, text="\n".join(news)))
        commands = re.findall(r"^(clustermcl .*?)(?: +#.*)?$", block.text, flags=re.M)
        seen |= {command for command in commands if not command.endswith("\\")}
    return left


@pytest.mark.parametrize("block", blocks(), ids=str)
def test_every_block_of_commands_has_a_comment_how_it_is_run_or_why_not(block: Block) -> None:
    known = {"runs: offline", "runs: live", "runs: certificates", *ELSEWHERE}
    assert block.mark in known or re.match(r"not run: \w.{10}", block.mark), block.text


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the files that the pages name: map, recording, true poses, landmarks."""
    folder = tmp_path_factory.mktemp("pages")
    hall = world("hall")
    write_map(hall.map, folder, "map")
    robot = Simulation(hall, 0, lidar=LidarModel(robot_from_laser=(0.0, 0.0, 0.0)))
    log, truth = [], []
    for _, tick in zip(range(300), robot, strict=False):
        ranges = np.nan_to_num(tick.laser.ranges.array(), posinf=81.83)
        stamp_s = tick.laser.stamp_ns / 1e9
        pose = tick.odometry[0].odom_from_robot
        log.append(flaser(f"{stamp_s:.3f}", pose, ranges.tolist()))
        truth.append(tum_line(tick.laser.stamp_ns, tick.map_from_robot))
    (folder / "robot.log").write_text("\n".join(log) + "\n")
    (folder / "truth.tum").write_text("".join(truth))
    tags = (REPOSITORY / "docs/tutorials/tags.md").read_text()
    (folder / "landmarks.yaml").write_text(tags.split("```yaml\n")[1].split("```")[0])
    return folder


def run(block: Block, folder: Path, router: str) -> str:
    """Run a block as it is; only the filter is smaller, and the router another."""
    programs = folder / "bin"
    programs.mkdir(exist_ok=True)
    options = " ".join(
        [*SMALL_FILTER, "--set", "worker.count=4", "--set", f"zenoh.router={router}"]
    )
    for name, words in (("clustermcl", f'-I -m clustermcl "$@" {options}'), ("python", '"$@"')):
        program = programs / name
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" {words}\n')
        program.chmod(0o755)
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", block.text],
        cwd=folder,
        env={**os.environ, "PATH": f"{programs}:{os.environ['PATH']}"},
        capture_output=True, text=True, timeout=280, check=False,
    )  # fmt: skip
    assert done.returncode == 0, (block.text, done.stdout, done.stderr)
    return done.stdout


@pytest.mark.parametrize("block", once(marked("offline")), ids=str)
def test_a_block_of_offline_commands_runs(block: Block, folder: Path, short_folder: str) -> None:
    output = run(block, folder, f"unixsock-stream/{short_folder}/router.sock")
    into = re.search(r"> (\S+)", block.text)
    assert output or (into and (folder / into[1]).stat().st_size)


@pytest.mark.parametrize("block", marked("offline", "python"), ids=str)
def test_an_offline_program_runs(
    block: Block, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    exec(compile(block.text, block.page, "exec"), {})
    assert re.search(r"localized|ambiguous|searching|\[6\.1", capsys.readouterr().out)


@pytest.fixture(scope="module")
def robot() -> Iterator[Settings]:
    """A robot in the hall that has driven a while."""
    hall = msgspec.structs.replace(SMALL.bridge, source="sim:hall")
    with system(msgspec.structs.replace(SMALL, bridge=hall), "--steps", "40") as tested:
        wait_until(lambda: tested.step == 39)
        yield patient_client(tested.settings)


@pytest.mark.parametrize("block", marked("live"), ids=str)
def test_a_block_of_commands_for_a_running_robot_runs(
    block: Block, folder: Path, robot: Settings
) -> None:
    # The run is over, so its pose is stale: exit code 4.
    text = re.sub(r"^clustermcl pose\b[^#\n]*", r"\g<0> || test $? = 4 ", block.text, flags=re.M)
    assert run(replace(block, text=text), folder, robot.zenoh.router)


LIVE_PROGRAMS = [
    *(
        (block.page, block.text, r"place\(s\) hold|\d+% at \(")
        for block in marked("live", "python")
    ),
    *((name, (EXAMPLES / f"{name}.py").read_text(), prints) for name, prints in LIVE.items()),
]


@pytest.mark.parametrize(("name", "program", "prints"), LIVE_PROGRAMS)
def test_a_program_for_a_running_robot_runs(
    name: str,
    program: str,
    prints: str,
    robot: Settings,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("clustermcl.client.Settings", lambda: robot)
    monkeypatch.setattr(sys, "argv", [name])
    exec(compile(program, name, "exec"), {"__name__": "__main__"})
    assert re.search(prints, capsys.readouterr().out)


def test_there_are_six_examples_and_each_is_short() -> None:
    assert {file.stem for file in EXAMPLES.glob("*.py")} == {*ALONE, *LIVE}
    for file in EXAMPLES.glob("*.py"):
        assert len(file.read_text().splitlines()) <= LONGEST_EXAMPLE, file


@pytest.mark.parametrize("name", ALONE)
def test_an_example_runs_by_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(EXAMPLES / f"{name}.py"))
    assert re.search(ALONE[name], capsys.readouterr().out, re.MULTILINE)


@pytest.mark.parametrize("block", marked("certificates"), ids=str)
def test_a_block_of_commands_for_certificates_runs(block: Block, tmp_path: Path) -> None:
    require_openssl()
    shutil.copytree(REPOSITORY / "deploy", tmp_path / "deploy")
    run(block, tmp_path, "")
    workers = set(re.findall(r"worker-\d", block.text))
    assert workers
    for worker in workers:
        assert (tmp_path / "certificates" / f"{worker}.toml").is_file()
        assert (tmp_path / "certificates" / f"{worker}.key").is_file()
        assert f'"{worker} publishes: ingress"' in (tmp_path / "router-secure.json5").read_text()


COORDINATOR = CoordinatorSettings(step_deadline_s=10.0, stale_after_s=PATIENCE_S)
WIRE = Path(__file__).resolve().parents[3] / "docs" / "wire.md"


def example() -> str:
    page = WIRE.read_text()
    code = page.split("<!-- robot example -->\n```python\n")[1].split("```")[0]
    assert len(code.splitlines()) <= 34
    return code


def test_the_example_of_the_wire_page_drives_a_robot(tmp_path: Path) -> None:
    bridge = BridgeSettings(map=str(write_room(tmp_path)), source="zenoh")
    settings = msgspec.structs.replace(SMALL, bridge=bridge, coordinator=COORDINATOR)
    with system(settings) as tested, tested.client as client:
        wait_until(lambda: len(client.status().workers) == 4)
        wait_until(lambda: "sensor_bridge" in {p.sender for p in client.status().processes})
        robot = subprocess.run(
            [sys.executable, "-c", example(), tested.settings.zenoh.router, "40"],
            capture_output=True, text=True, timeout=PATIENCE_S, check=False,
        )  # fmt: skip
        wait_until(lambda: client.status().steps_applied >= 9)
        wait_until(lambda: client.pose().freshness == "fresh")
        status = client.status()
    assert robot.returncode == 0, robot.stderr
    assert "'schema': 'pose/1'" in robot.stdout
    # 40 readings, 0.05 m apart, a step each 0.2 m; the last scan still waits for odometry.
    assert status.steps_applied in (9, 10)
    assert status.steps_lost == 0
