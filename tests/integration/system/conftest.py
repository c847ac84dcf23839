"""Whole systems: router, workers, coordinator and a simulated robot as processes of their own."""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import msgspec
import pytest

from clustermcl.stack import Stack, meeting_in
from particle_filter.settings import BeliefSettings, ClusterSettings, SearchSettings
from process_runtime.settings import BridgeSettings, CoordinatorSettings, Settings, WorkerSettings

SMALL = Settings(
    seed=3,
    cluster=ClusterSettings(particles=300, min_particles=75),
    search=SearchSettings(poses=4_000, max_steps=20),
    belief=BeliefSettings(max_clusters=6, particles=1_180, search_every_steps=12),
    bridge=BridgeSettings(source="sim:cross_feature", rate=0.0),
    worker=WorkerSettings(count=4),
    coordinator=CoordinatorSettings(lockstep_deadline_s=60.0),
)
"""A filter small enough for tests, on a simulated robot, as fast as the workers follow."""

StartStack = Callable[..., tuple[Stack, Settings]]


@pytest.fixture(scope="module")
def start_stack() -> Iterator[StartStack]:
    """Starts systems, each meeting at a socket of its own; all are ended after the module."""
    with ExitStack() as resources:

        def start(settings: Settings, *, steps: int) -> tuple[Stack, Settings]:
            folder = Path(resources.enter_context(tempfile.TemporaryDirectory(prefix="mcl-")))
            cache = msgspec.structs.replace(settings.worker, cache_folder=str(folder / "cache"))
            met = meeting_in(folder, msgspec.structs.replace(settings, worker=cache))
            arguments = ("--steps", str(steps))
            stack = Stack(met, folder, logs_in_folder=True, simulator_arguments=arguments)
            resources.enter_context(closing(stack))
            return stack, met

        yield start
