"""The smallest world in which several places stay possible, and a filter with few particles."""

from functools import cache

from msgspec.structs import replace

from clustermcl.filter.settings import ClusterSettings, SearchSettings
from clustermcl.protocol.steps import Scan
from clustermcl.runtime.settings import BridgeSettings, CoordinatorSettings
from tests.unit.coordinator import living

MAP = living.MAP
SETTINGS = replace(
    living.SETTINGS,
    cluster=ClusterSettings(particles=12),
    search=SearchSettings(
        poses=60, heading_step_rad=0.5, shards=2, source_radius_m=2.0, source_heading_rad=1.6,
        max_steps=3, hand_over_particles=10,
    ),
    belief=replace(living.SETTINGS.belief, max_clusters=3, elsewhere_poses=20),
)  # fmt: skip
COORDINATOR = CoordinatorSettings(
    step_deadline_s=0.3, lockstep_deadline_s=5.0, take_over_after_s=1.0, snapshot_every_steps=3
)

BRIDGE = BridgeSettings(gate_distance_m=0.05)


@cache
def scan_of(number: int) -> Scan:
    """What the robot sees on its way, in every schedule alike."""
    return living.scan_of(number)
