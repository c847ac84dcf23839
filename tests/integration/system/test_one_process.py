import signal
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path

import msgspec
import psutil
import pytest

from clustermcl.client import Client
from clustermcl.runtime.settings import Settings, ZenohSettings
from clustermcl.runtime.settings_table import settings_as_toml
from tests.integration.alone import assert_same, outcomes_of
from tests.integration.system.commands import TypedCommand, ran, typed
from tests.integration.system.conftest import SMALL
from tests.integration.waiting import PATIENCE_S, wait_until

STEPS = 120


@pytest.fixture
def settings(zenoh_settings: ZenohSettings, tmp_path: Path) -> Settings:
    worker = msgspec.structs.replace(SMALL.worker, count=0, cache_folder=str(tmp_path / "cache"))
    zenoh = msgspec.structs.replace(zenoh_settings, connect_timeout_s=30.0)
    coordinator = msgspec.structs.replace(SMALL.coordinator, state_folder=str(tmp_path / "state"))
    return msgspec.structs.replace(SMALL, zenoh=zenoh, worker=worker, coordinator=coordinator)


@pytest.fixture
def words(settings: Settings, tmp_path: Path) -> list[str]:
    file = tmp_path / "settings.toml"
    file.write_text(settings_as_toml(settings))
    return ["up", "--one-process", "--settings", str(file)]


@pytest.fixture
def up(words: list[str], tmp_path: Path) -> Iterator[TypedCommand]:
    with typed(*words, folder=tmp_path) as command:
        yield command


def test_one_process_believes_as_several_ends_by_ctrl_c_and_continues_after_a_kill(
    up: TypedCommand, words: list[str], settings: Settings, tmp_path: Path
) -> None:
    """Many believe what a run without Zenoh believes; see `test_same_beliefs`."""
    with Client(settings) as client:
        received = list(
            takewhile(lambda belief: belief.step < STEPS, client.beliefs(timeout_s=PATIENCE_S))
        )
        status = client.status()
    assert len(received) > STEPS // 4
    assert_same(received, outcomes_of(settings, steps=STEPS))
    assert not psutil.Process(up.pid).children()
    assert {process.sender for process in status.processes} == {"one-process"}
    assert status.workers.keys() == {"one-process"}
    second = ran(*words)
    assert second.returncode == 2
    assert "is in use" in second.stderr
    up.kill()
    folder = tmp_path / "again"
    folder.mkdir()
    with typed(*words, folder=folder) as again:
        with Client(settings) as client:
            wait_until(lambda: client.status().step > status.step)
            wait_until(lambda: bool(client.hypotheses().hypotheses))
        assert again.end(signal.SIGINT) == 0
        assert "Traceback" not in again.err


@pytest.mark.parametrize(("refused", "says"), [
    *((setting, f"{setting} needs several processes")
      for setting in ("worker.count=2", "zenoh.start_router=false", "coordinator.standby=true")),
    ("bridge.map=missing.yaml", "missing.yaml: no such file"),
])  # fmt: skip
def test_settings_that_cannot_be_used_are_refused(
    words: list[str], refused: str, says: str
) -> None:
    ended = ran(*words, "--set", "bridge.source=zenoh", "--set", refused)
    assert ended.returncode == 2
    assert says in ended.stderr
    assert "Traceback" not in ended.stderr
