from typing import cast

import msgspec
import pytest
import zenoh
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.parser import text_string_to_metric_families

from clustermcl.link import metrics
from clustermcl.link.metrics_of_status import StatusCollector
from clustermcl.protocol.answers import Status
from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime.settings import MetricsSettings
from tests.unit.evaluation import places

STATUS = msgspec.structs.replace(
    places.STATUS, overloaded=True, scan_age_s=3.5, floors={"third": 0.9},
    workers={"worker-0": ("c1", "c2"), "worker-1": ()},
)  # fmt: skip

Samples = dict[tuple[str, tuple[tuple[str, str], ...]], float]


def scraped(status: Status | None) -> Samples:
    registry = CollectorRegistry()
    registry.register(StatusCollector(lambda: status, "r1"))
    text = generate_latest(registry).decode()
    samples = [
        sample for family in text_string_to_metric_families(text) for sample in family.samples
    ]
    assert all(sample.labels.pop("robot") == "r1" for sample in samples), "fleets tell them apart"
    return {(one.name, tuple(sorted(one.labels.items()))): one.value for one in samples}


def process(name: str, role: str, **labels: str) -> tuple[tuple[str, str], ...]:
    return tuple(sorted({"process": name, "role": role, **labels}.items()))


def test_every_figure_of_the_status_is_a_metric() -> None:
    samples = scraped(STATUS)
    worker = process("worker-0", "worker")
    dropped = process("coordinator", "coordinator", cause="scan of another map")
    for key, value in {
        ("clustermcl_up", ()): 1.0,
        ("clustermcl_info", (("map_digest", "abc"), ("version", "1.2"))): 1.0,
        ("clustermcl_state", (("clustermcl_state", "localized"),)): 1.0,
        ("clustermcl_state", (("clustermcl_state", "lost"),)): 0.0,
        ("clustermcl_pose_freshness", (("clustermcl_pose_freshness", "stale"),)): 0.0,
        ("clustermcl_pose_freshness", (("clustermcl_pose_freshness", "dead_reckoning"),)): 0.0,
        ("clustermcl_pose_age_seconds", ()): 0.25,
        ("clustermcl_scan_age_seconds", ()): 3.5,
        ("clustermcl_step", ()): 41.0,
        ("clustermcl_steps_applied_total", ()): 40.0,
        ("clustermcl_steps_lost_total", ()): 1.0,
        ("clustermcl_reports_missing_total", ()): 2.0,
        ("clustermcl_clusters", ()): 3.0,
        ("clustermcl_searching", ()): 1.0,
        ("clustermcl_overloaded", ()): 1.0,
        ("clustermcl_floor_probability", (("floor", "third"),)): 0.9,
        ("clustermcl_workers", ()): 2.0,
        ("clustermcl_worker_jobs", (("worker", "worker-0"),)): 2.0,
        ("clustermcl_process_uptime_seconds", worker): 9.0,
        ("clustermcl_process_health_age_seconds", worker): 5.0,
        ("clustermcl_process_info", process("worker-0", "worker", version="1.1")): 1.0,
        ("clustermcl_process_done_total", process("worker-0", "worker", what="reports")): 80.0,
        ("clustermcl_process_idle_seconds", process("worker-0", "worker", what="reports")): 5.25,
        ("clustermcl_process_memory_bytes", process("coordinator", "coordinator")): 50e6,
        ("clustermcl_dropped_total", dropped): 7.0,
    }.items():
        assert samples[key] == value, key


def test_before_the_first_scan_a_pose_has_no_age() -> None:
    none = msgspec.structs.replace(STATUS, age_s=-1.0, scan_age_s=-1.0, freshness="none")
    samples = scraped(none)
    assert ("clustermcl_pose_age_seconds", ()) not in samples
    assert ("clustermcl_scan_age_seconds", ()) not in samples


def test_a_coordinator_that_does_not_answer_is_down() -> None:
    assert scraped(None) == {("clustermcl_up", ()): 0.0}


def test_the_library_is_needed_with_a_port_only_and_its_extra_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(metrics, "find_spec", lambda _name: None)
    session = lambda: cast(zenoh.Session, None)  # noqa: E731
    with metrics.metrics_served(MetricsSettings(), "r1", session):
        pass
    served = metrics.metrics_served(MetricsSettings(port=9464), "r1", session)
    with pytest.raises(SettingsError, match=r"metrics\.port = 9464 .* 'clustermcl\[metrics\]'"):
        served.__enter__()
