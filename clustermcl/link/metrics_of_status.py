"""The status message as Prometheus metrics: names, units, help texts."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import get_args

from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    InfoMetricFamily,
    Metric,
    StateSetMetricFamily,
)
from prometheus_client.registry import Collector

from clustermcl.protocol.answers import Freshness, State, Status
from clustermcl.protocol.health import Health

_PROCESS = ("process", "role")


class StatusCollector(Collector):
    """Queries the status at each scrape; the robot's name is a label of all metrics."""

    def __init__(self, status: Callable[[], Status | None], robot: str) -> None:
        self._status, self._robot = status, robot

    def collect(self) -> Iterator[Metric]:
        for metric in self._collected():
            metric.samples = [
                sample._replace(labels={"robot": self._robot, **sample.labels})
                for sample in metric.samples
            ]
            yield metric

    def _collected(self) -> Iterator[Metric]:
        status = self._status()
        yield _gauge("up", "Whether the coordinator answers.", float(status is not None))
        if status is not None:
            yield from _of_localization(status)
            yield from _of_processes(status.processes)

    def describe(self) -> Iterable[Metric]:
        """Return nothing; the default would call `collect` before a coordinator can answer."""
        return ()


def _of_localization(status: Status) -> Iterator[Metric]:
    info = {"version": status.version, "map_digest": status.map_digest}
    yield InfoMetricFamily("clustermcl", "Version of the coordinator and digest of its map.", info)
    yield _states("state", "State of the localization.", status.state, get_args(State))
    yield _states("pose_freshness", "Freshness of the pose.", status.freshness, get_args(Freshness))
    if status.age_s >= 0.0:
        yield _gauge("pose_age_seconds", "Age of the data behind the pose.", status.age_s)
    if status.scan_age_s >= 0.0:
        yield _gauge("scan_age_seconds", "Age of the last weighed scan.", status.scan_age_s)
    yield _gauge("step", "Number of the newest step.", status.step)
    yield _counter("steps_applied", "Steps that changed the belief.", status.steps_applied)
    yield _counter("steps_lost", "Steps without a scan or a report.", status.steps_lost)
    yield _counter("reports_missing", "Reports that arrived too late.", status.reports_missing)
    yield _gauge("clusters", "Places that are tracked.", status.clusters)
    yield _gauge("searching", "Whether a global search is under way.", float(status.searching))
    yield _gauge("overloaded", "Whether steps wait to be decided.", float(status.overloaded))
    yield _gauge("workers", "Workers that are alive.", len(status.workers))
    if status.floors:
        yield _labelled("floor_probability", "Probability of a floor.", "floor", status.floors)
    jobs = {worker: len(held) for worker, held in status.workers.items()}
    yield _labelled("worker_jobs", "Jobs of a worker.", "worker", jobs)


def _labelled(name: str, meaning: str, label: str, values: Mapping[str, float]) -> Metric:
    family = GaugeMetricFamily(f"clustermcl_{name}", meaning, labels=[label])
    for of, value in values.items():
        family.add_metric([of], value)
    return family


def _of_processes(processes: tuple[Health, ...]) -> Iterator[Metric]:
    info = InfoMetricFamily(
        "clustermcl_process", "Version of a process.", labels=[*_PROCESS, "version"]
    )
    health_age = _family("health_age_seconds", "Time since a process published its health.")
    uptime = _family("uptime_seconds", "Time since a process started.")
    memory = _family("memory_bytes", "Resident memory of a process.")
    idle = _family("idle_seconds", "Time since a process last did this.", "what")
    gauge = _family("gauge", "A present value of a process, with its unit in its name.", "what")
    done = CounterMetricFamily(
        "clustermcl_process_done", "What a process has done, by kind.", labels=[*_PROCESS, "what"]
    )
    dropped = CounterMetricFamily(
        "clustermcl_dropped", "What was dropped or refused, by cause.", labels=[*_PROCESS, "cause"]
    )
    for process in processes:
        labels = [process.sender, process.role]
        info.add_metric([*labels, process.version], {})
        health_age.add_metric(labels, process.age_s)
        uptime.add_metric(labels, process.uptime_s)
        memory.add_metric(labels, process.memory_bytes)
        idle_s = {what: age_s + process.age_s for what, age_s in process.ages_s.items()}
        tables = ((idle, idle_s), (gauge, process.gauges), (done, process.done))
        for family, values in (*tables, (dropped, process.dropped)):
            for of, value in values.items():
                family.add_metric([*labels, of], value)
    yield from (info, health_age, uptime, memory, idle, gauge, done, dropped)


def _gauge(name: str, meaning: str, value: float) -> Metric:
    return GaugeMetricFamily(f"clustermcl_{name}", meaning, value)


def _counter(name: str, meaning: str, value: float) -> Metric:
    return CounterMetricFamily(f"clustermcl_{name}", meaning, value)


def _states(name: str, meaning: str, now: str, all_of_them: Iterable[str]) -> Metric:
    values = {state: state == now for state in all_of_them}
    return StateSetMetricFamily(f"clustermcl_{name}", meaning, values)


def _family(name: str, meaning: str, *labels: str) -> GaugeMetricFamily:
    return GaugeMetricFamily(f"clustermcl_process_{name}", meaning, labels=[*_PROCESS, *labels])
