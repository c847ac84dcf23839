"""How one odometry motion errs: its parts and their standard deviations, without particles."""

from math import atan2, hypot, pi

from particle_filter.arrays import Pose
from particle_filter.poses import heading_distance, wrap_angle
from particle_filter.settings import MotionSettings

_NO_BEARING_BELOW_M = 0.01
"""A differential drive shorter than this is a turn on the spot: its bearing is noise [m]."""


def along_across_turn(motion: Pose, settings: MotionSettings) -> tuple[float, ...]:
    """Bearing, drive, turn; standard deviations along the drive, across it, of the turn."""
    drive, turn = hypot(motion[0], motion[1]), float(motion[2])
    drive_by_turn = settings.drive_noise_per_turn * turn
    return (
        atan2(motion[1], motion[0]) if drive > 0.0 else 0.0,
        drive,
        turn,
        hypot(settings.drive_noise_per_metre * drive, drive_by_turn),
        hypot(settings.strafe_noise_per_metre * drive, drive_by_turn),
        hypot(settings.turn_noise_per_turn * turn, settings.turn_noise_per_metre * drive),
    )


def turn_drive_turn(motion: Pose, settings: MotionSettings) -> tuple[float, ...]:
    """First turn, drive, second turn, and the standard deviation of each (table 5.6)."""
    drive = hypot(motion[0], motion[1])
    turn_1 = atan2(motion[1], motion[0]) if drive >= _NO_BEARING_BELOW_M else 0.0
    turn_2 = wrap_angle(float(motion[2]) - turn_1)
    # Driving backwards is two half turns on paper; the robot turns by neither.
    turned_1, turned_2 = (
        min(float(heading_distance(turn, 0.0)), float(heading_distance(turn, pi)))
        for turn in (turn_1, turn_2)
    )
    turn_by_drive = settings.turn_noise_per_metre * drive
    return (
        turn_1,
        drive,
        turn_2,
        hypot(settings.turn_noise_per_turn * turned_1, turn_by_drive),
        hypot(
            settings.drive_noise_per_metre * drive,
            settings.drive_noise_per_turn * hypot(turned_1, turned_2),
        ),
        hypot(settings.turn_noise_per_turn * turned_2, turn_by_drive),
    )
