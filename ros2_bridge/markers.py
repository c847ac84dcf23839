"""Markers for RViz: an arrow, an ellipse and a percentage for each place."""

import colorsys
import math
from typing import Any

import numpy as np

from protocol.answers import Belief, Hypothesis
from protocol.pose_arrays import covariance_matrix
from ros2_bridge import message_types as types
from ros2_bridge.message_types import new
from ros2_bridge.messages_out import header, pose

MOST_DRAWN = 50
"""Limit for the number of drawn places; more are not distinguishable."""

_ARROW, _CYLINDER, _TEXT = 0, 3, 9
_DELETE_ALL = 3
_ARROW_M, _ARROW_WIDTH_M = 0.8, 0.1
_SIGMAS = 2.0
_LEAST_M, _HEIGHT_M, _TEXT_ABOVE_M, _TEXT_M = 0.05, 0.02, 0.5, 0.4
_GOLDEN_RATIO = 0.618034
"""Hues in steps of it are well separated."""


def markers(belief: Belief, frame: str) -> Any:
    """A `visualization_msgs/MarkerArray` that replaces the previous one."""
    shared = header(belief.stamp_ns, frame)
    clean = new("visualization_msgs/msg/Marker", header=shared, action=_DELETE_ALL)
    drawn = [
        marker
        for hypothesis in belief.hypotheses[:MOST_DRAWN]
        for marker in _place(hypothesis, shared)
    ]
    return new(types.MARKER_ARRAY, markers=[clean, *drawn])


def _place(place: Hypothesis, shared: Any) -> tuple[Any, Any, Any]:
    number = place.cluster % 2**31
    x, y, _ = place.mean
    long_m, short_m, direction_rad = _ellipse(place)
    colour = _colour(place)
    arrow = _marker(shared, "arrow", number, _ARROW, place.mean, colour)
    arrow.scale = _scale(_ARROW_M, _ARROW_WIDTH_M, _ARROW_WIDTH_M)
    ellipse = _marker(shared, "ellipse", number, _CYLINDER, (x, y, direction_rad), colour)
    ellipse.scale = _scale(long_m, short_m, _HEIGHT_M)
    percentage = _marker(shared, "percentage", number, _TEXT, (x, y, 0.0), colour)
    percentage.pose.position.z = _TEXT_ABOVE_M
    percentage.scale = _scale(0.0, 0.0, _TEXT_M)
    percentage.text = f"{100.0 * place.probability:.0f} %"
    percentage.color.a = 1.0
    return arrow, ellipse, percentage


def _ellipse(place: Hypothesis) -> tuple[float, float, float]:
    """Long and short axis [m], and the direction of the long one [rad]."""
    values, vectors = np.linalg.eigh(covariance_matrix(place.covariance)[:2, :2])
    short, long = (max(2.0 * _SIGMAS * math.sqrt(max(v, 0.0)), _LEAST_M) for v in values.tolist())
    return long, short, math.atan2(vectors[1, 1], vectors[0, 1])


def _colour(place: Hypothesis) -> Any:
    red, green, blue = colorsys.hsv_to_rgb(place.cluster * _GOLDEN_RATIO % 1.0, 0.9, 0.9)
    alpha = 0.3 + 0.7 * place.probability
    return new("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=alpha)


def _marker(
    shared: Any, namespace: str, number: int, kind: int, at: tuple[float, float, float], colour: Any
) -> Any:
    return new(
        "visualization_msgs/msg/Marker",
        header=shared,
        ns=namespace,
        id=number,
        type=kind,
        pose=pose(at),
        color=new("std_msgs/msg/ColorRGBA", r=colour.r, g=colour.g, b=colour.b, a=colour.a),
    )


def _scale(x: float, y: float, z: float) -> Any:
    return new("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
