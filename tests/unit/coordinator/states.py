"""Checkpoints of a coordinator that tracks clusters, as it published them."""

from msgspec.structs import replace

from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.work import Checkpoint
from tests.unit.coordinator.test_coordinator import Story

TERM = 7


def checkpoint_at(place: PoseTuple, *, live: bool = True, x_m: float = 0.0) -> Checkpoint:
    """Of one that is nearly sure of a place, and was there at odometry `x_m`."""
    story = Story("a")
    story.scan(0, live=live, x_m=x_m)
    story.finds({place: 0.9, (1.0, 1.0, 0.0): 0.1})
    return replace(story.checkpoints[-1], term=TERM)
