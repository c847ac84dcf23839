import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from process_runtime.ros2_settings import Ros2Settings
from protocol.reading_checks import laser_problem
from protocol.steps import LaserReading
from recordings.rigid import IDENTITY, Rigid
from ros2_bridge import message_types as types
from ros2_bridge.laser_scans import BEAMS, RANGE_MAX_M, cloud_reading
from ros2_bridge.message_types import decode, encode, new
from ros2_bridge.messages_out import header

SETTINGS = Ros2Settings(min_height_m=0.1, max_height_m=1.0)
STEP_RAD = 2.0 * math.pi / BEAMS


def cloud(
    points: Any,
    *,
    kind: str = "f4",
    big: bool = False,
    rows: int = 1,
    padding: int = 4,
    stamp_ns: int = 7,
) -> Any:
    """A `sensor_msgs/PointCloud2` as drivers make it, as it comes from the wire."""
    points = np.asarray(points, np.float64)
    width = np.dtype(kind).itemsize
    step = 3 * width + padding
    dtype = np.dtype(
        {
            "names": ["x", "y", "z"],
            "formats": [(">" if big else "<") + kind] * 3,
            "offsets": [0, width, 2 * width],
            "itemsize": step,
        }
    )
    packed = np.zeros(len(points), dtype)
    for axis, name in enumerate("xyz"):
        packed[name] = points[:, axis]
    fields = [
        new(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=axis * width,
            datatype=7 if kind == "f4" else 8,
            count=1,
        )
        for axis, name in enumerate("xyz")
    ]
    message = new(
        types.POINT_CLOUD,
        header=header(stamp_ns, "/lidar"),
        height=rows,
        width=len(points) // rows,
        fields=fields,
        is_bigendian=big,
        point_step=step,
        row_step=step * (len(points) // rows),
        data=np.frombuffer(packed.tobytes(), np.uint8),
    )
    return decode(encode(message, types.POINT_CLOUD), types.POINT_CLOUD)


def reading_of(
    points: Any, mount: Rigid = IDENTITY, settings: Ros2Settings = SETTINGS, **form: Any
) -> LaserReading:
    return cloud_reading(cloud(points, **form), mount, (1.0, 2.0, 0.5), settings)


def naive(points: NDArray[np.float64], mount: Rigid, settings: Ros2Settings) -> NDArray[np.float32]:
    """What pointcloud_to_laserscan does, point by point."""
    ranges = np.full(BEAMS, np.inf)
    for point in points:
        if not np.isfinite(point).all():
            continue
        place = mount.of(Rigid(point[0], point[1], point[2], 0.0, 0.0, 0.0, 1.0))
        x, y = place.x - mount.x, place.y - mount.y
        if not settings.min_height_m <= place.z <= settings.max_height_m:
            continue
        far = math.hypot(x, y)
        if far >= RANGE_MAX_M:
            continue
        beam = int((math.atan2(y, x) + math.pi) / STEP_RAD) % BEAMS
        ranges[beam] = min(ranges[beam], far)
    return ranges.astype(np.float32)


def test_the_nearest_point_between_the_heights_is_the_range_of_its_direction() -> None:
    points = [(2.0, 0.01, 0.5), (3.0, 0.01, 0.5), (1.0, 0.01, 0.05), (1.0, 0.01, 1.2)]
    reading = reading_of([*points, (0.01, -4.0, 1.0), (math.nan, 1.0, 0.5), (1.0, math.inf, 0.5)])
    ranges = reading.ranges.array()
    angles = reading.angle_min_rad + reading.angle_step_rad * np.arange(BEAMS)
    seen = np.isfinite(ranges)
    np.testing.assert_allclose(ranges[seen], [4.0, 2.0], atol=1e-4)
    np.testing.assert_allclose(angles[seen], [-math.pi / 2.0, 0.0], atol=STEP_RAD)
    assert (reading.stamp_ns, reading.laser) == (7, "lidar/points")
    assert reading.odom_from_robot == (1.0, 2.0, 0.5)
    assert laser_problem(reading) is None


@example(points=[(4.9324690591030885e-17, 0.0, 0.0)], tilt_rad=0.0, turn_rad=0.5)
@given(
    points=st.lists(
        st.tuples(*[st.floats(-5.0, 5.0, width=32) | st.just(math.nan)] * 3),
        min_size=1,
        max_size=30,
    ),
    tilt_rad=st.floats(-0.5, 0.5),
    turn_rad=st.floats(-3.0, 3.0),
)
def test_the_slice_equals_one_computed_point_by_point(
    points: list[tuple[float, float, float]], tilt_rad: float, turn_rad: float
) -> None:
    tilted = Rigid(0.0, 0.0, 0.0, math.sin(tilt_rad / 2.0), 0.0, 0.0, math.cos(tilt_rad / 2.0))
    turned = Rigid(0.3, -0.2, 0.6, 0.0, 0.0, math.sin(turn_rad / 2), math.cos(turn_rad / 2))
    mount = turned.of(tilted)
    given_points = np.array(points, np.float64).reshape(-1, 3)
    reading = reading_of(given_points, mount)
    expected, ranges = naive(given_points, mount, SETTINGS), reading.ranges.array()
    # A point on the edge of a beam, at a height or in the laser may fall to either side.
    differ = ~np.isclose(np.nan_to_num(ranges, posinf=1e6), np.nan_to_num(expected, posinf=1e6))
    assert differ.sum() <= 2 * on_an_edge(given_points, mount)
    assert reading.robot_from_laser == pytest.approx((0.3, -0.2, 0.0))


def on_an_edge(points: NDArray[np.float64], mount: Rigid) -> int:
    count = 0
    for point in points[np.isfinite(points).all(axis=1)]:
        place = mount.of(Rigid(point[0], point[1], point[2], 0.0, 0.0, 0.0, 1.0))
        x, y = place.x - mount.x, place.y - mount.y
        beam = (math.atan2(y, x) + math.pi) / STEP_RAD
        at_edge = abs(beam - round(beam)) < 1e-6 or math.hypot(x, y) < 1e-9
        heights = (SETTINGS.min_height_m, SETTINGS.max_height_m)
        count += at_edge or min(abs(place.z - h) for h in heights) < 1e-5
    return count


@pytest.mark.parametrize(
    "form", [{"kind": "f8"}, {"big": True}, {"kind": "f8", "big": True, "padding": 0}, {"rows": 2}]
)
def test_points_in_any_valid_layout_are_read(form: dict[str, Any]) -> None:
    points = [(2.0, 0.5, 0.5), (-3.0, 1.5, 0.25)]
    np.testing.assert_array_equal(
        reading_of(points, **form).ranges.array(), reading_of(points).ranges.array()
    )


def test_ranges_are_bounded_by_the_settings() -> None:
    settings = Ros2Settings(laser_min_range_m=1.0, laser_max_range_m=3.0)
    reading = reading_of([(0.5, 0.0, 0.5), (0.0, 2.0, 0.5), (-4.0, 0.0, 0.5)], settings=settings)
    assert np.isfinite(reading.ranges.array()).sum() == 1
    assert reading.range_max_m == 3.0


@pytest.mark.parametrize(
    ("field", "value", "problem"),
    [
        ("point_step", 8, "does not fit"),
        ("row_step", 4, "does not fit"),
        ("height", 2**31, "does not fit"),
        ("width", 0, "without points"),
        ("width", 2**32 - 1, "does not fit"),
        ("fields", [], "without x as float32 or float64"),
    ],
)
def test_a_malformed_point_cloud_is_refused(field: str, value: object, problem: str) -> None:
    broken = cloud([(1.0, 0.0, 0.5)] * 3)
    setattr(broken, field, value)
    with pytest.raises(ValueError, match=problem):
        cloud_reading(broken, IDENTITY, (0.0, 0.0, 0.0), SETTINGS)


@given(
    sizes=st.tuples(*[st.integers(0, 2**32 - 1) | st.integers(0, 40)] * 4),
    offset=st.integers(0, 2**32 - 1) | st.integers(0, 40),
)
def test_random_point_cloud_layouts_raise_only_value_errors(
    sizes: tuple[int, int, int, int], offset: int
) -> None:
    broken = cloud([(1.0, 0.0, 0.5)] * 3)
    broken.height, broken.width, broken.point_step, broken.row_step = sizes
    broken.fields[2].offset = offset
    try:
        reading = cloud_reading(broken, IDENTITY, (0.0, 0.0, 0.0), SETTINGS)
    except ValueError as problem:
        assert "fit into" in str(problem) or "without points" in str(problem)  # noqa: PT017 - or it is a reading
    else:
        assert len(reading.ranges.array()) == BEAMS
