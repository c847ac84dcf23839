"""Directions of the beams of an `FLASER` line, which says only how many there are."""

import math

_SICK = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5, 400: 0.25, 401: 0.25, 200: 0.5, 201: 0.5}
"""Beams to step [degrees], of the fields of 180 and 100 degrees that SICK's lasers have."""
_COMMON_STEPS_DEG = (1.0, 0.5, 0.25)


def flaser_angles(beams: int, step_deg: float | None = None) -> tuple[float, float]:
    """Direction of the first beam and step between beams.

    A fan looks straight ahead. Of an even number of beams the last one is left out, as SICK's
    lasers and CARMEN do: 181 beams reach from -90 to +90 degrees, 180 from -90 to +89.

    1. The numbers that SICK's lasers give have their steps (CARMEN's own table).
    2. Else the log's parameter `laser_front_laser_resolution` counts, where there is one.
    3. Else the largest of 1, 0.5 and 0.25 degrees with which the field is 180 to 270 degrees:
       541 beams are 270 degrees, 761 are 190.
    4. Else the beams are spread over 180 degrees, as CARMEN does.

    Args:
        beams: number of beams, at least 1.
        step_deg: the parameter of the log [degrees].

    Returns:
        angle of beam 0 and step between beams [rad], counter-clockwise.
    """
    steps = beams if beams % 2 == 0 else max(beams - 1, 1)
    step_deg = _SICK.get(beams) or _plausible(step_deg, steps) or _common(steps) or 180.0 / steps
    return -math.radians(step_deg * steps / 2.0), math.radians(step_deg)


def _plausible(step_deg: float | None, steps: int) -> float | None:
    return step_deg if step_deg is not None and 0.0 < step_deg * steps <= 360.0 else None


def _common(steps: int) -> float | None:
    fitting = (step for step in _COMMON_STEPS_DEG if 180.0 <= step * steps <= 270.0)
    return next(fitting, None)
