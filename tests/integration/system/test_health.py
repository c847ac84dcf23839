"""Health: the status of all processes, for people, for programs and for Prometheus."""

import json
import urllib.error
import urllib.request
from collections.abc import Iterator

import msgspec
import pytest
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.samples import Sample

from clustermcl.client import Client
from process_runtime.settings import MetricsSettings, Settings
from tests.integration.free_port import free_port
from tests.integration.system.conftest import SMALL, StartStack
from tests.integration.system.test_queries import typed
from tests.integration.waiting import PATIENCE_S, patient_client, stretched_s, wait_until

STEPS = 20
PROCESSES = {"coordinator", "robot_simulator", *(f"worker-{n}" for n in range(4))}


@pytest.fixture(scope="module")
def system(start_stack: StartStack) -> Settings:
    """A robot that has driven some steps, and a port for metrics."""
    metrics = MetricsSettings(port=free_port())
    stack, settings = start_stack(msgspec.structs.replace(SMALL, metrics=metrics), steps=STEPS)
    stack.start_all()
    settings = patient_client(settings)
    with Client(settings) as client:
        wait_until(lambda: client.pose().step == STEPS - 1)
        wait_until(lambda: {p.sender for p in client.status().processes} == PROCESSES)
        wait_until(lambda: all(p.done for p in client.status().processes))
        wait_until(lambda: _done(client, "robot_simulator", "steps") == STEPS)
        wait_until(lambda: _done(client, "coordinator", "scans") >= STEPS)
    return settings


def _done(client: Client, process: str, what: str) -> int:
    return next(p.done.get(what, 0) for p in client.status().processes if p.sender == process)


def scraped(settings: Settings) -> Iterator[Sample]:
    url = f"http://127.0.0.1:{settings.metrics.port}/metrics"
    with urllib.request.urlopen(url, timeout=PATIENCE_S) as answer:
        assert answer.headers["Content-Type"].startswith("text/plain")
        text = answer.read().decode()
    for family in text_string_to_metric_families(text):
        assert family.documentation, family.name
        assert family.name.startswith("clustermcl")
        yield from family.samples


def test_the_status_has_the_health_of_every_process(system: Settings) -> None:
    with Client(system) as client:
        processes = {process.sender: process for process in client.status().processes}
    for process in processes.values():
        assert process.age_s < stretched_s(3.0)
        assert process.uptime_s > 0.0
        assert process.memory_bytes > 10_000_000
    assert processes["robot_simulator"].done["steps"] == STEPS
    assert processes["coordinator"].done["scans"] >= STEPS
    for worker in PROCESSES - {"coordinator", "robot_simulator"}:
        assert 0 < processes[worker].done["scans"] <= STEPS  # one may have come a little late
    assert processes["robot_simulator"].rates_per_s.keys() >= {"odometry", "scans", "steps"}
    assert processes["coordinator"].version == processes["worker-0"].version


def test_the_status_is_for_people_and_for_programs(system: Settings) -> None:
    text = typed(system, "status").stdout
    assert "processes\n  coordinator (coordinator) " in text
    assert f"steps: {STEPS}, " in text
    status = json.loads(typed(system, "status", "--json").stdout)
    assert {process["name"] for process in status["processes"]} == PROCESSES


def test_prometheus_scrapes_the_figures_of_the_status(system: Settings) -> None:
    values = {
        (sample.name, sample.labels.get("process")): sample.value for sample in scraped(system)
    }
    assert values["clustermcl_up", None] == 1.0
    assert values["clustermcl_steps_applied_total", None] == STEPS
    assert values["clustermcl_workers", None] == 4.0
    for name in PROCESSES:
        assert values["clustermcl_process_uptime_seconds", name] > 0.0


def test_metrics_are_served_to_this_machine_alone(system: Settings) -> None:
    url = f"http://127.0.0.2:{system.metrics.port}/metrics"
    with pytest.raises(urllib.error.URLError, match="refused"):
        urllib.request.urlopen(url, timeout=2.0)
