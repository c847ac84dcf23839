"""Settings of whole systems: router, workers, coordinator and a simulated robot as processes."""

from clustermcl.filter.settings import BeliefSettings, ClusterSettings, SearchSettings
from clustermcl.runtime.settings import (
    BridgeSettings,
    CoordinatorSettings,
    Settings,
    WorkerSettings,
)

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
