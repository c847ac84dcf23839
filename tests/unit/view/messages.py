"""Messages as a system sends them, small."""

from typing import Any

import numpy as np
from msgspec.structs import replace

from clustermcl.protocol.answers import Belief, Hypothesis, PoseAnswer, Status
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.health import Health, SourceHealth
from clustermcl.protocol.job_events import Began, JobEvents, NumberedEvent
from clustermcl.protocol.steps import MapMessage, Scan
from tests.unit.coordinator import reports
from tests.unit.evaluation import places


def hypothesis(cluster: int, probability: float) -> Hypothesis:
    spread = (0.4, 0.1, 0.0, 0.1, 0.3, 0.0, 0.0, 0.0, 0.2)
    made = places.place(probability, (float(cluster), 2.0, 0.5), cluster=cluster, covariance=spread)
    return replace(made, log_probability=float(np.log(probability)), age_steps=3)


def belief(step: int, *clusters: int, term: int = 1) -> Belief:
    shown = [hypothesis(cluster, 0.9 / len(clusters)) for cluster in clusters]
    made = places.belief(step, "ambiguous", *shown, elsewhere_probability=0.1, term=term)
    return replace(made, stamp_ns=step)


def scan(step: int, ranges: list[float], *, digest: str = "d1") -> Scan:
    return reports.scan(
        step, digest=digest, stamp_ns=step, robot_from_laser=(1.0, 0.0, 0.0),
        angle_step_rad=np.pi / 2, ranges=ArrayBlob.of(np.array(ranges), "float32"),
    )  # fmt: skip


def events(*numbers: int, term: int = 1) -> JobEvents:
    numbered = tuple(
        NumberedEvent(number=n, step=n, stamp_ns=n, event=Began(f"c{n}", "restart", 0.1))
        for n in numbers
    )
    return JobEvents(sender="coordinator", events=numbered, term=term)


POSE = replace(
    places.ANSWER, state="ambiguous", age_s=0.1, probability=0.5, pose=(1.0, 2.0, 0.5), workers=2,
    covariance=(0.04, 0.0, 0.0, 0.0, 0.09, 0.0, 0.0, 0.0, 0.01), term=1, elsewhere_probability=0.1,
)  # fmt: skip


def pose(step: int, **changed: Any) -> PoseAnswer:
    return replace(POSE, **{"step": step, "stamp_ns": step, **changed})


STATUS = replace(
    places.STATUS, version="1", state="ambiguous", age_s=0.1, step=5, steps_applied=6, steps_lost=0,
    reports_missing=0, map_digest="d1", clusters=2, searching=False, processes=(), uptime_s=9.0,
    workers={"w-0": ("c1", "c2"), "w-1": ()}, counters={"late": 2, "never": 0},
)  # fmt: skip


def status(*, digest: str = "d1", **changed: Any) -> Status:
    return replace(STATUS, map_digest=digest, **changed)


EYE = SourceHealth(name="eye exit", outlier_rate=0.7)


def simulator() -> Health:
    """As the simulator publishes it: there is a robot that can be lifted."""
    return Health(sender="simulator", role="bridge", version="1", uptime_s=1.0, sources=(EYE,))


def map_message(digest: str = "d1") -> MapMessage:
    return MapMessage(
        sender="bridge",
        digest=digest,
        cell_m=0.5,
        map_from_grid=(0.0, 0.0, 0.0),
        rows=2,
        cols=3,
        zlib_cells=b"",
    )
