import json
import math
import subprocess
import urllib.error
import urllib.request
from collections.abc import Iterator
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from PIL import Image, ImageColor
from prometheus_client.parser import text_string_to_metric_families

from clustermcl.client import Client, NotLocalizedError
from clustermcl.protocol.answers import PoseAnswer
from clustermcl.protocol.errors import UnreachableError
from clustermcl.runtime.settings import MetricsSettings, Settings
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.faults.system import system as running_system
from tests.integration.free_port import free_port
from tests.integration.system.commands import ran
from tests.integration.system.conftest import SMALL
from tests.integration.waiting import PATIENCE_S, patient, patient_client, wait_until

STEPS = 30
PROCESSES = {"coordinator", "simulator", *(f"worker-{n}" for n in range(4))}


@pytest.fixture(scope="module")
def system() -> Iterator[Settings]:
    """A robot that has driven thirty steps and stands still since, and a port for metrics."""
    hall = msgspec.structs.replace(SMALL.bridge, source="sim:hall")
    metrics = MetricsSettings(port=free_port())
    settings = msgspec.structs.replace(SMALL, bridge=hall, metrics=metrics)
    with running_system(settings, "--steps", str(STEPS)) as tested, tested.client as client:
        wait_until(lambda: client.pose().step == STEPS - 1)
        wait_until(lambda: {p.sender for p in client.status().processes} == PROCESSES)
        wait_until(lambda: all(p.done for p in client.status().processes))
        wait_until(lambda: _done(client, "simulator", "steps") == STEPS)
        wait_until(lambda: _done(client, "coordinator", "scans") >= STEPS)
        yield patient_client(tested.settings)


def _done(client: Client, process: str, what: str) -> int:
    return next(p.done.get(what, 0) for p in client.status().processes if p.sender == process)


def typed(settings: Settings, *words: str) -> subprocess.CompletedProcess[str]:
    zenoh, at = patient(settings.zenoh), 1 + words[0].startswith("--")  # options of the command
    options = [
        word
        for name in ("router", "connect_timeout_s", "query_timeout_s")
        for word in ("--set", f"zenoh.{name}={getattr(zenoh, name)}")
    ]
    return ran(*words[:at], *options, *words[at:])


def asked(settings: Settings, *words: str) -> Any:
    done = typed(settings, *words, "--json")
    assert done.stderr == ""
    return json.loads(done.stdout)


def test_pose_hypotheses_and_status_are_printed_as_json(system: Settings) -> None:
    pose, answer = asked(system, "pose"), asked(system, "hypotheses")
    assert (pose["step"], pose["workers"]) == (STEPS - 1, 4)
    assert pose["probability"] > 0.3
    assert pose["freshness"] in ("fresh", "stale")
    assert len(pose["pose"]["covariance"]) == 3
    probabilities = [place["probability"] for place in answer["hypotheses"]]
    assert probabilities == sorted(probabilities, reverse=True)
    assert sum(probabilities) + answer["elsewhere_probability"] == pytest.approx(1.0)
    above = asked(system, "hypotheses", "--above", "0.2")["hypotheses"]
    assert [place["probability"] for place in above] == [p for p in probabilities if p >= 0.2]
    advice = asked(system, "advise")
    likely = [p["cluster"] for p in answer["hypotheses"] if p["probability"] >= 0.01]
    assert (advice["step"], advice["clusters"]) == (STEPS - 1, likely)
    assert advice["ways"] or "places" in advice["note"] or "place is" in advice["note"]
    status = asked(system, "status")
    counted = [status[name] for name in ("steps_applied", "steps_lost", "reports_missing")]
    assert counted == [STEPS, 0, 0]
    assert set(status["workers"]) == {name for name in PROCESSES if name.startswith("worker")}
    assert {process["name"] for process in status["processes"]} == PROCESSES
    assert status["clusters"] >= 1
    text = typed(system, "status").stdout
    assert "processes\n  coordinator (coordinator) " in text
    assert f"steps: {STEPS}, " in text


def test_a_snapshot_of_a_running_system_is_saved(system: Settings, tmp_path: Path) -> None:
    file = tmp_path / "now.png"
    assert typed(system, "snapshot", str(file)).returncode == 0
    with Image.open(file) as image:
        assert max(image.size) > 1000
        colours = {colour for _, colour in image.convert("RGB").getcolors(2**24) or ()}
    assert ImageColor.getrgb("#2a323b") in colours, "walls"


def test_prometheus_scrapes_the_status_only_from_this_machine(system: Settings) -> None:
    path = f":{system.metrics.port}/metrics"
    with urllib.request.urlopen(f"http://127.0.0.1{path}", timeout=PATIENCE_S) as answer:
        families = list(text_string_to_metric_families(answer.read().decode()))
    values = {
        (sample.name, sample.labels.get("process")): sample.value
        for family in families
        for sample in family.samples
    }
    assert values["clustermcl_up", None] == 1.0
    assert values["clustermcl_steps_applied_total", None] == STEPS
    assert values["clustermcl_workers", None] == 4.0
    for name in PROCESSES:
        assert values["clustermcl_process_uptime_seconds", name] > 0.0
    with pytest.raises(urllib.error.URLError, match="refused"):
        urllib.request.urlopen(f"http://127.0.0.2{path}", timeout=2.0)


def test_a_robot_that_sends_nothing_any_more_is_stale(system: Settings) -> None:
    with Client(system) as client:
        wait_until(lambda: client.pose().freshness == "stale")
        with pytest.raises(NotLocalizedError, match="stale") as refused:
            client.wait_until_localized(timeout_s=0.2)
        with pytest.raises(UnreachableError, match="stand still"):
            next(client.beliefs(timeout_s=0.3))
        found, hall, beliefs = client.map(), world("hall").map, client.beliefs(timeout_s=0.3)
    with pytest.raises(ValueError, match="not connected"):
        next(beliefs)
    assert refused.value.answer.step == STEPS - 1
    assert (found.digest, found.map_from_grid) == (hall.digest, hall.map_from_grid)
    assert np.array_equal(found.cells, hall.cells)
    done = typed(system, "pose")
    assert "stale: the newest data is" in done.stdout
    assert done.returncode == 4


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded")
def test_a_dropped_iterator_unsubscribes_and_a_forked_child_is_refused(system: Settings) -> None:
    with Client(system) as client, Client(system) as other:
        publisher: Any = other._session.declare_publisher("own")  # its stub is wrong
        with pytest.raises(UnreachableError, match="published nothing"):
            next(client.published("own", PoseAnswer, 0.1))
        wait_until(lambda: not publisher.matching_status.matching)
        child = get_context("fork").Process(target=client.pose, daemon=True)
        child.start()
        child.join(PATIENCE_S)
        assert child.exitcode == 1
        with pytest.raises(ValueError, match="shape"):
            client.kidnap((0.0, 0.0))


def test_events_show_how_every_place_began_and_why_others_ended(system: Settings) -> None:
    events = asked(system, "events")["events"]
    assert [event["number"] for event in events] == list(range(len(events)))
    assert {"first search", "search over"} <= {event["cause"] for event in events}
    began = {event["job_id"] for event in events if event["event"] == "began"}
    ended = {event["job_id"] for event in events if event["event"] == "ended"}
    places = asked(system, "hypotheses")["hypotheses"]
    assert began - ended == {f"c{place['cluster']}" for place in places}
    lines = typed(system, "events").stdout.splitlines()
    assert {line.partition(":")[0] for line in lines} == {f"step {one['step']}" for one in events}
    assert "found by the first search" in lines[0]
    assert sum(line.endswith("search 0 is over") for line in lines) == 1, "of all its shards"


def test_a_pose_that_a_person_gives_is_believed_at_once(system: Settings) -> None:
    done = typed(system, "set-pose", "5.0", "6.0", "446.0")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "robot 'robot' was set to x 5.00 m  y 6.00 m  heading 86.0 deg\n"
    with Client(system) as client:
        answer: PoseAnswer = client.pose()
    assert answer.pose == pytest.approx((5.0, 6.0, math.radians(86.0)))
    assert answer.probability == pytest.approx(0.817, abs=0.001)  # of 0.95, within 1 m
    assert answer.state == "searching", "no scan has confirmed it: the recording is over"


def test_relocalize_forgets_all_places(system: Settings) -> None:
    assert "drops all places; the search runs everywhere" in typed(system, "relocalize").stdout
    assert typed(system, "--quiet", "relocalize").stdout == ""
    with Client(system) as client:
        answer = client.hypotheses()
    assert answer.hypotheses == ()
    assert answer.pose.state == "searching"
