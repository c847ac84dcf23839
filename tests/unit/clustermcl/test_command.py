import logging
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from clustermcl.commands.command import COMMANDS, app
from clustermcl.commands.verbosity import is_verbose
from clustermcl.protocol.errors import ClusterMclError, RecordingError
from clustermcl.runtime.logs import configure_logging, is_quiet
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import load_settings
from tests.integration.system.commands import ran
from tests.unit.recordings.bags import grid, scan, written

ASKING = [*COMMANDS["Query a running system"], *COMMANDS["Control a running system"], "up", "view"]
ASKING.remove("changes")  # of several robots: see `test_new_map`


def typed(*words: str) -> str:
    result = CliRunner().invoke(app, words, prog_name="clustermcl", terminal_width=80)
    assert result.exit_code == 0, result.output
    return result.output


def test_every_command_has_its_help() -> None:
    listed = typed("-h")
    for name, (_, does) in ((n, c) for group in COMMANDS.values() for n, c in group.items()):
        assert name in listed
        assert does in " ".join(typed(name, "--help").split()), "its first line"


@pytest.mark.parametrize("name", ASKING)
def test_every_client_command_has_options_for_robot_and_router(name: str) -> None:
    shown = typed(name, "--help")
    for each in ("--robot", "--router", "CLUSTERMCL_ROBOT", "CLUSTERMCL_ROUTER"):
        assert each in shown


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["demo", "--listen", "127.0.0.1:1"], "--listen has no effect without --view"),
        (["up", "--allow-commands"], "--allow-commands has no effect without --view"),
        (["view", "--save", "m.html"], "--save has no effect without a recording"),
        (["view", "run.mcap", "--robot", "r2"], "--robot has no effect on a recorded run; leave"),
        (["view", "run.mcap", "--set", "a.b=1"], "--set has no effect on a recorded run; leave"),
        (["view", "run.mcap", "--save", "a", "--listen", "b"], "--listen has no effect on a saved"),
        (["demo", "--view", "--listen", "0.0.0.0:8350"], "a loopback address and a port"),
        (["demo", "--recording", "sim:atlantis"], "'atlantis'; the worlds are cross"),
        (["demo", "--recording", "zenoh"], "--recording: a live robot has no end"),
        (["settings", "--set", "cluster.particels=5"], "did you mean cluster.particles?"),
        (["settings", "--set", "cluster.particles=many"], "cluster.particles = 'many'"),
        (["warm-up", "--set", "bridge.map=missing.yaml"], "missing.yaml: no such file"),
        (["settings", "--from-nav2", "missing.yaml"], "missing.yaml: no such file"),
        (["pose", "--robot", "a b"], "--robot: robot.name = 'a b': expected letters"),
        (["evaluate", "sim:cross", "--seeds", "2", "--tum", "a.tum"], "leave out --seeds"),
        (["evaluate", "sim:cross", "--seeds", "2", "--plot", "a.png"], "--plot a.png: a file has"),
        (["evaluate", "sim:hall", "--reference", "r.tum"], "--reference: a simulated robot"),
        (["evaluate", "sim:hall", "--starts", "2"], "--starts: a simulated robot"),
        (["evaluate", "a.log"], "--map is missing: a recording needs"),
        (["changes", "--recording", "a.log"], "--map is missing: a recording needs"),
        (["evaluate", "sim:"], "no simulated world ''; the worlds are cross"),
        (["demo", "--map", "no.yaml"], "no.yaml: no such file"),
        (["snapshot", "now.jpg"], "its name must end in .png"),
        (["evaluate", "sim:hall", "--tum", "a.csv"], "its name must end in .tum"),
        (["set-pose", "1", "nan", "1"], "pose (1.0, nan, "),
        (["relocalize", "--near", "1", "2", "-3"], "near is x, y and a radius above 0, all"),
        (["set-pose", "1", "2", "3", "--heading-sigma-deg", "0"], "sigma_rad: expected `float` >"),
        (["evaluate", "sim:hall", "--floor", "1"], "--floor has no effect without --map"),
        (["evaluate", "a", "--map", "b", "--floor", "1"], "--floor has no effect without --ref"),
        (["check", "a.yaml", "--base-frame", "b"], "--base-frame has no effect without a ROS bag"),
        (["snapshot", "none/now.png"], "its folder does not exist"),
        (["view", "none.mcap"], "none.mcap: no such file"),
        (["evaluate", "sim:cross", "--output", "runs.csv.gz"], "must end in .csv"),
    ],
    ids=" ".join,
)  # fmt: skip
def test_a_mistake_of_the_command_line_is_refused_in_words(words: list[str], message: str) -> None:
    result = CliRunner().invoke(app, words)
    assert isinstance(result.exception, ClusterMclError), result.output
    assert message in str(result.exception)


def test_topics_and_frames_named_on_the_command_line_are_settings(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    read: list[Settings] = []

    def loaded(*given: Any) -> Settings:
        read.append(load_settings(*given))
        return read[0]

    monkeypatch.setattr("clustermcl.commands.options.load_settings", loaded)
    words = ["--scan-topic", "/a", "--odom-topic", "/b", "--odom-frame", "c", "--base-frame", "d"]
    words = ["demo", "--recording", "robot.bag", *words, "--set", "bridge.laser_x_m=0.2"]
    assert isinstance(CliRunner().invoke(app, words).exception, ClusterMclError), "there is no bag"
    bridge = read[0].bridge
    named = (bridge.scan_topic, bridge.odom_topic, bridge.odom_frame, bridge.base_frame)
    assert (*named, bridge.laser_x_m) == ("/a", "/b", "c", "d", 0.2)


def test_a_bag_has_its_map_and_of_two_scan_topics_one_must_be_named(tmp_path: Path) -> None:
    sent = [grid(1, [[0, 100]]), scan(2), scan(3, topic="/rear/scan")]
    result = CliRunner().invoke(app, ["evaluate", str(written(tmp_path, "mcap", sent))])
    assert isinstance(result.exception, RecordingError)
    assert "--scan-topic" in str(result.exception)


@pytest.mark.parametrize(("words", "code", "says"), [
    *((f"{name} --router unixsock-stream//tmp/clustermcl-nobody-listens-here", 3, "no router")
      for name in ("pose", "watch", "relocalize")),
    ("pose --router nonsense", 2, "nonsense"),
    ("watch --robot a/b", 2, "a/b"),
])  # fmt: skip
def test_an_unreachable_system_has_another_exit_code_than_wrong_usage(
    words: str, code: int, says: str
) -> None:
    done = ran(*words.split())
    assert (done.returncode, done.stdout) == (code, "")
    assert says in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.fixture(autouse=True)
def usual_logging() -> Iterator[None]:
    """Handlers of pytest's own come back as they were."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    root.handlers = []
    configure_logging("clustermcl", "warning")
    yield
    root.handlers = handlers
    root.setLevel(level)


def test_options_before_the_command_reach_the_processes_unless_a_setting_differs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen: list[str] = []

    def checked(given: Settings) -> None:
        seen.append(given.log.level)
        raise SystemExit

    monkeypatch.setattr("clustermcl.commands.up._check_in_child", checked)
    for words in (["up"], ["--quiet", "up"], ["-q", "up"], ["-v", "up"], ["up"]):
        configure_logging("clustermcl", "warning")
        assert CliRunner().invoke(app, words).exit_code == 0
        assert (is_quiet(), is_verbose()) == (words[0] in ("--quiet", "-q"), words[0] == "-v")
    CliRunner().invoke(app, ["-v", "up", "--set", "log.level=warning"])
    usual = Settings().log.level
    assert seen == [usual, "error", "error", "debug", usual, "warning"]


def test_a_shell_offers_commands() -> None:
    words = {"COMP_WORDS": "clustermcl hyp", "COMP_CWORD": "1"}
    asked = {"_CLUSTERMCL_COMPLETE": "complete_bash", **words}
    found = CliRunner().invoke(app, env=asked, prog_name="clustermcl")
    assert found.output.split() == ["hypotheses"]


@pytest.mark.parametrize("printing", ["settings --all", "evaluate sim:cross --steps 1"])
def test_a_reader_that_has_ended_is_no_bug(printing: str) -> None:
    words = f"{sys.executable} -I -m clustermcl {printing} | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", words], capture_output=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (130, b"")
