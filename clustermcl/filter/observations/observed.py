"""The kinds of observations."""

from typing import TypeAlias

from clustermcl.filter.observations.field import Field
from clustermcl.filter.observations.fixes import PoseFix, PositionFix
from clustermcl.filter.observations.sighting import Sighting

Observed: TypeAlias = PoseFix | PositionFix | Sighting | Field
