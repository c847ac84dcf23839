"""What a process or the library does not use, it does not load: a start costs time and memory."""

import pytest

from tests.unit.programs import ran

COMPILERS = {"numba", "llvmlite", "scipy"}
"""Of the 160 MB of a process that computes, 100 are these."""
ROOMS = {f"clustermcl.{room}" for room in ("commands", "coordinator", "evaluation", "link", "view")}


@pytest.mark.parametrize(
    ("modules", "heavy"),
    [
        ("clustermcl", {"zenoh", "numba", "numpy", "scipy", "msgspec", "typer"}),
        ("clustermcl.localizer", {*ROOMS, *COMPILERS, "clustermcl.worker", "zenoh", "mcap", "PIL"}),
        ("clustermcl.filter.poses, clustermcl.filter.random_streams", COMPILERS),
        ("clustermcl.belief.log_probabilities, clustermcl.belief.overlaps", COMPILERS),
        *((f"clustermcl.{name}", COMPILERS) for name in (
            "sensor_bridge.process", "coordinator.process", "client", "commands.up",
        )),
        ("clustermcl.runtime.main, clustermcl.link.inbox, clustermcl.link.session, "
         "clustermcl.link.router, clustermcl.runtime.supervisor",
         {*COMPILERS, "numpy", "PIL", "yaml", "typer", "rich"}),
    ],
)  # fmt: skip
def test_nothing_heavy_is_loaded_that_is_not_used(modules: str, heavy: set[str]) -> None:
    loaded = ran(f"import sys, {modules}; print(*sys.modules)").stdout.split()
    assert heavy & set(loaded) == set()
