"""`clustermcl check`: is a map suitable, and does a recording match it?"""

import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import msgspec

from clustermcl.changes.collector import ChangeCollector
from clustermcl.commands.as_text import pose_text
from clustermcl.commands.kernels import prepare_kernels
from clustermcl.commands.options import AsJson, argument, option, print_answer, recording_command
from clustermcl.evaluation.map_check.agreement import Agreement, agreement_of
from clustermcl.evaluation.map_check.drawing import drawn_report
from clustermcl.evaluation.map_check.look_alikes import WAY_M
from clustermcl.evaluation.map_check.report import MapReport, report_of
from clustermcl.protocol.errors import MapFileError
from clustermcl.protocol.floors import Floors
from clustermcl.recordings.maps.landmarks import landmarks_of_map
from clustermcl.recordings.maps.map_file import load_map_with_obstacles
from clustermcl.runtime.output_files import check_output_file
from clustermcl.runtime.settings import Settings
from clustermcl.sensor_bridge.recorded import opened, steps_of
from clustermcl.view.plots import new_figure, save

MOST_CELLS = 2**26
"""Limit for the cells of a map; the check needs about 42 bytes for each."""
EXIT_ANOTHER_MAP = 1
_MOST_PLACES = 8


@recording_command
def check(
    settings: Settings,
    map_file: Annotated[str, argument("MAP", "Map file.")],
    recording: Annotated[Path | None, option("Recording of a robot in that map.", "FILE")] = None,
    laser_range_m: Annotated[
        float, option("Range of the laser [m].", "M", flag="--range", min=0.5)
    ] = 12.0,
    places: Annotated[int, option("Number of tested places.", min=1, max=1_000)] = 24,
    picture: Annotated[
        Path | None, option("Draw the report on the map.", "FILE.png", flag="--report")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Check whether a map is suitable, and which places look alike.

    With a recording, also check whether it matches the map.
    """
    if picture is not None:
        check_output_file(picture, ".png")
        new_figure()  # raises before the check, not after it
    grid_map = load_map_with_obstacles(map_file)
    if grid_map.cells.size > MOST_CELLS:
        rows, cols = grid_map.cells.shape
        problem = f"{cols} x {rows} cells are known; the limit of check is {MOST_CELLS}"
        raise MapFileError(map_file, f"{problem}: crop the map or use larger cells")
    grid_map = grid_map.with_landmarks(landmarks_of_map(map_file, grid_map.floors))
    read = None if recording is None else opened(str(recording), settings.bridge)
    prepare_kernels(settings.sensor)
    agreement = changes = None
    if read is not None:
        scans = steps_of(read, settings.bridge, grid_map.digest)
        collector = ChangeCollector(grid_map)
        agreement = agreement_of(scans, grid_map, settings, read.readings, collector)
        changes = collector.changes("check")
    report = report_of(
        map_file,
        grid_map,
        laser_range_m=laser_range_m,
        places=places,
        seed=settings.seed,
        agreement=agreement,
    )
    if picture is not None:
        save(drawn_report(report, grid_map, changes), picture)
    print_answer(msgspec.to_builtins(report) if as_json else lines_of(report, grid_map.floors))
    if agreement is not None and agreement.is_of_another_map:
        sys.exit(EXIT_ANOTHER_MAP)


def lines_of(report: MapReport, floors: Floors) -> Iterator[str]:
    ground = report.ground
    yield (
        f"{report.map}: {ground.cols} x {ground.rows} cells of {ground.cell_m} m, "
        f"{ground.width_m:.1f} x {ground.height_m:.1f} m"
    )
    pieces = "in one piece" if ground.pieces == 1 else f"in {ground.pieces} pieces"
    yield f"free: {ground.free_m2:.0f} m2, {pieces}; unknown: {ground.unknown_share:.0%} of the map"
    yield from _looks(report, floors)
    if report.agreement is not None:
        yield from _agreement(report.agreement)
    if not report.remarks:
        yield "The map is suitable for localization."
    for remark in report.remarks:
        yield f"* {remark}"


def _looks(report: MapReport, floors: Floors) -> Iterator[str]:
    looked_at = len(report.places)
    alone = sum(not place.look_alikes for place in report.places)
    how = f"a laser that sees {report.laser_range_m} m all around, up to {WAY_M:.0f} m of driving"
    yield f"{alone} of {looked_at} places are unique ({how})"
    alike = max(report.places, key=lambda place: len(place.look_alikes))
    if not alike.look_alikes:
        return
    places = (alike.pose, *alike.look_alikes)
    yield f"  these {len(places)} places look alike:"
    for floor, pose in map(floors.on_floor, places[:_MOST_PLACES]):
        yield f"    {pose_text(pose, floor)}"
    if len(places) > _MOST_PLACES:
        yield f"    and {len(places) - _MOST_PLACES} more"


def _agreement(agreement: Agreement) -> Iterator[str]:
    yield (
        f"recording: localized on {agreement.localized_share:.0%} of the first "
        f"{agreement.steps} steps; probability off the map {agreement.off_map_probability:.0%}"
    )
    mirrored = f"localized on {agreement.decoy_localized_share:.0%}"
    yield f"  its mirror image (a robot off the map): {mirrored}"
    if agreement.fitting_share is not None:
        yield f"  {agreement.fitting_share:.0%} of the beams end where the map has an obstacle"
    if (lag := agreement.lag) is not None:
        yield f"  laser's stamps: {lag.lag_s:+.2f} +-{lag.standard_error_s:.2f} s by odometry's"
    if agreement.mount is None:
        yield "  laser and odometry cannot be checked: the robot is localized or turns too briefly"
        return
    x, y, heading = agreement.mount.robot_from_laser
    x_off, y_off, heading_off = agreement.mount.standard_errors
    yield (
        f"  laser: {x:.2f} +-{x_off:.2f} m ahead, {y:.2f} +-{y_off:.2f} m left, "
        f"{math.degrees(heading):.1f} +-{math.degrees(heading_off):.1f} deg"
    )
    drives, turns = agreement.mount.odometry_distance_scale, agreement.mount.odometry_turn_scale
    drives_off, turns_off = agreement.mount.scale_errors
    yield (
        f"  odometry: {drives - 1.0:+.1%} +-{drives_off:.1%} of the distance, "
        f"{turns - 1.0:+.1%} +-{turns_off:.1%} of the turns"
    )
