"""Settings that can change while the robot drives."""

from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta

_NotNegative: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e9)] | None
_Positive: TypeAlias = Annotated[float, Meta(gt=0.0, le=1e9)] | None
_Share: TypeAlias = Annotated[float, Meta(gt=0.0, le=1.0)] | None


class LiveSettings(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Settings that change while the system runs; None: the value at the start of the processes.

    Every scan carries them, so that all workers weigh a step with the same values, also after
    another coordinator takes over.
    """

    gate_distance_m: _NotNegative = None
    gate_turn_rad: _NotNegative = None
    turn_noise_per_turn: _NotNegative = None
    turn_noise_per_metre: _NotNegative = None
    drive_noise_per_metre: _NotNegative = None
    drive_noise_per_turn: _NotNegative = None
    strafe_noise_per_metre: _NotNegative = None
    max_beams: Annotated[int, Meta(gt=0, le=65_536)] | None = None
    hit_sigma_m: _Positive = None
    hit_weight: _Share = None
    random_weight: _Share = None


AS_STARTED = LiveSettings()
