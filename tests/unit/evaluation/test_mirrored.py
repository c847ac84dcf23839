import math

import msgspec
import numpy as np

from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.steps import LaserBeams, mirrored
from tests.unit.coordinator.reports import scan as scan_of
from tests.unit.recordings.logs import beam_ends

MOUNT = (0.3, 0.1, 0.4)
SCAN = msgspec.structs.replace(
    scan_of(3), odom_from_robot=(1.0, 2.0, 0.5), robot_from_laser=MOUNT, angle_min_rad=-1.0,
    ranges=ArrayBlob.of(np.array([1.0, 2.0, np.inf, 4.0]), "float32"),
)  # fmt: skip


def test_beams_end_on_the_other_side_of_the_robot() -> None:
    other = LaserBeams(
        robot_from_laser=(-0.3, 0.0, math.pi),
        angle_min_rad=-0.7,
        angle_step_rad=0.2,
        range_max_m=8.0,
        ranges=ArrayBlob.of(np.array([3.0, 5.0]), "float32"),
    )
    scan = msgspec.structs.replace(SCAN, others=(other,), motion_by_scans=(0.3, 0.1, 0.2))
    image = mirrored(scan)
    for before, after in ((scan, image), (other, image.others[0])):
        np.testing.assert_allclose(
            beam_ends(after)[::-1], beam_ends(before) * (1.0, -1.0), atol=1e-12
        )
    assert image.odom_from_robot == (1.0, -2.0, -0.5)
    assert image.motion_by_scans == (0.3, -0.1, -0.2)
    assert mirrored(image) == scan
