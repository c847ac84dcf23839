"""Compiles the report of `clustermcl check` on a map, with its warnings."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator

import msgspec
import numpy as np
from scipy.ndimage import binary_dilation, label

from clustermcl.evaluation.map_check.agreement import FITS_WITHIN_M, Agreement
from clustermcl.evaluation.map_check.look_alikes import WAY_M, LookAlikeSearch
from clustermcl.filter.arrays import FREE, UNKNOWN
from clustermcl.filter.poses import between
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.pose_arrays import pose_tuple
from clustermcl.recordings.maps.grid_map import GridMap

_COARSE_CELL_M = 0.1
_WHOLE_SHARE = 0.9
_OPEN_SHARE = 0.3
_BLIND_SHARE = 0.3
_FOUND_SHARE, _FITTING_SHARE = 0.1, 0.7
_MOUNT_OFF_M, _MOUNT_OFF_RAD, _SIGMAS = 0.15, 0.06, 3.0
_SCALE_OFF = 0.05
_LAG_S = 0.1
_DECOY_SHARE = 0.3
SMALLEST_PIECE_M2 = 0.5


class Ground(msgspec.Struct, frozen=True, kw_only=True):
    """Statistics of a map."""

    rows: int
    cols: int
    cell_m: float
    width_m: float
    height_m: float
    free_m2: float
    unknown_share: float
    pieces: int
    """Number of connected components of free ground of at least 0.5 m², or 1."""
    largest_piece_share: float
    """Share of the free ground in the largest component."""
    open_rim_share: float
    """Share of unknown cells among the cells that border free ground."""


def ground_of(grid_map: GridMap) -> Ground:
    cells = grid_map.cells
    numbers, _ = label(cells == FREE)
    sizes = np.bincount(numbers.ravel())[1:] * grid_map.cell_m**2
    # Ground off the map is unknown, too.
    padded = np.pad(cells, 1, constant_values=UNKNOWN)
    rim = padded[binary_dilation(padded == FREE) & (padded != FREE)]
    rows, cols = cells.shape
    width_m, height_m = grid_map.size_m
    return Ground(
        rows=rows,
        cols=cols,
        cell_m=grid_map.cell_m,
        width_m=width_m,
        height_m=height_m,
        free_m2=grid_map.grid.free_m2,
        unknown_share=float(np.mean(cells == UNKNOWN)),
        pieces=max(int(np.count_nonzero(sizes >= SMALLEST_PIECE_M2)), 1),
        largest_piece_share=float(sizes.max() / sizes.sum()),
        open_rim_share=float(np.mean(rim == UNKNOWN)) if len(rim) else 0.0,
    )


class Place(msgspec.Struct, frozen=True, kw_only=True):
    """A pose at which the map was tested, and the poses that look alike."""

    pose: PoseTuple
    """In the map: x [m], y [m], heading [rad]."""
    returned_share: float
    """Share of the beams that hit something within the laser's range."""
    look_alikes: tuple[PoseTuple, ...]
    """The poses from which the view is nearly the same."""


class MapReport(msgspec.Struct, frozen=True, kw_only=True):
    """The results of `clustermcl check`."""

    map: str
    ground: Ground
    laser_range_m: float
    places: tuple[Place, ...]
    agreement: Agreement | None
    remarks: tuple[str, ...] = ()
    """Problems of the map, and of the recording, as sentences."""


def report_of(
    name: str,
    grid_map: GridMap,
    *,
    laser_range_m: float,
    places: int,
    seed: int,
    agreement: Agreement | None,
) -> MapReport:
    """Test a map at random places.

    Raises:
        NoRoomError: no robot fits into the map.
    """
    search = LookAlikeSearch(grid_map, laser_range_m, np.random.default_rng(seed))
    found = []
    for _ in range(places):
        view = search.random_view()
        pose, *others = map(pose_tuple, search.places_like(view))
        found.append(Place(pose=pose, returned_share=view.returned_share, look_alikes=(*others,)))
    report = MapReport(
        map=name,
        ground=ground_of(grid_map),
        laser_range_m=laser_range_m,
        places=tuple(found),
        agreement=agreement,
    )
    remarks = (
        *_of_ground(report.ground, is_one_map=len(grid_map.floors.names) < 2),
        *_of_places(report),
        *floor_remarks(((p.pose, *p.look_alikes) for p in report.places), grid_map),
        *(_of_agreement(agreement) if agreement is not None else ()),
        *grid_map.remarks,
        *_of_landmarks(grid_map),
    )
    return msgspec.structs.replace(report, remarks=remarks)


def _of_ground(ground: Ground, *, is_one_map: bool) -> Iterator[str]:
    if ground.cell_m > _COARSE_CELL_M:
        yield f"cells of {ground.cell_m} m are coarse, walls may be that far off; 0.05 m is usual"
    if is_one_map and ground.largest_piece_share < _WHOLE_SHARE:
        outside = 1.0 - ground.largest_piece_share
        yield (
            f"the free ground lies in {ground.pieces} pieces, {outside:.0%} of it outside the "
            "largest: is a door closed in the map, or was it seen through windows?"
        )
    if ground.open_rim_share > _OPEN_SHARE:
        yield f"{ground.open_rim_share:.0%} of the rim of the free ground was not mapped"


def _of_places(report: MapReport) -> Iterator[str]:
    looked_at = len(report.places)
    blind = sum(place.returned_share < _BLIND_SHARE for place in report.places)
    if blind:
        yield (
            f"from {blind} of {looked_at} places most beams hit nothing within "
            f"{report.laser_range_m} m: there, only odometry is left"
        )
    alike = sum(bool(place.look_alikes) for place in report.places)
    if alike:
        yield (
            f"{alike} of {looked_at} places look like others, also after {WAY_M:.0f} m of "
            "driving: until something distinguishes them, the belief is ambiguous; landmarks do "
            "(docs/tutorials/tags.md)"
        )


def floor_remarks(groups: Iterable[tuple[PoseTuple, ...]], grid_map: GridMap) -> Iterator[str]:
    """Yield remarks on groups of poses in the atlas that look alike; the first was tested."""
    floors = grid_map.floors
    tested, alike = Counter[str](), Counter[tuple[str, str]]()
    for pose, *others in groups:
        here, _ = floors.on_floor(pose)
        tested[here] += 1
        alike.update({(here, floors.on_floor(other)[0]) for other in others})
    for (here, there), count in sorted(alike.items()):
        if here != there:
            yield (
                f"{count} of {tested[here]} places on floor {here} look like places on floor "
                f"{there}: until something distinguishes them, the floor is ambiguous; an "
                "observation of the floor does (docs/tutorials/floors.md)"
            )
    for link in floors.links:
        for name, (x, y) in link.at.items():
            across, up, _ = floors.in_atlas(name, (x, y, 0.0))
            if grid_map.cells[int(up / grid_map.cell_m), int(across / grid_map.cell_m)] != FREE:
                place = f"x {x:.2f} m, y {y:.2f} m is not free ground"
                yield f"link {link.name} ends in a wall on floor {name}: {place}"


def _of_landmarks(grid_map: GridMap) -> Iterator[str]:
    corner, (width, height) = np.array(grid_map.map_from_grid), grid_map.size_m
    outside = []
    for each in grid_map.landmarks:
        x, y, _ = between(corner, np.array([each.x, each.y, 0.0]))
        if not (0.0 <= x <= width and 0.0 <= y <= height):
            outside.append(each.name)
    if outside:
        count = f"{len(outside)} of {len(grid_map.landmarks)} landmarks"
        yield (
            f"{count} lie outside the map, such as {outside[0]}: are they in its frame, in metres?"
        )


def _of_agreement(agreement: Agreement) -> Iterator[str]:
    fitting, mount = agreement.fitting_share, agreement.mount
    localized, decoy = agreement.localized_share, agreement.decoy_localized_share
    if decoy > localized + _DECOY_SHARE:
        yield (
            f"the mirror image of the recording is localized on {decoy:.0%} of the steps, the "
            f"recording at {localized:.0%}: is the laser upside down, or do its angles run the "
            "other way?"
        )
    elif decoy > _DECOY_SHARE:
        yield (
            f"the mirror image of the recording is localized, too, on {decoy:.0%} of the steps: "
            "the map is much like its own mirror image where the robot drove, and a robot that "
            "is not there may look localized"
        )
    if agreement.is_of_another_map:
        yield (
            f"the robot is probably not on this map ({agreement.off_map_probability:.0%} on the "
            "average): is the recording of this building, and has it changed since?"
        )
    if agreement.localized_share < _FOUND_SHARE or fitting is None:
        yield (
            f"the robot was localized on {agreement.localized_share:.0%} of {agreement.steps} "
            "steps of the recording: is it of this building, and are its frames the right ones?"
        )
        return
    if fitting < _FITTING_SHARE:
        yield (
            f"only {fitting:.0%} of the beams end within {FITS_WITHIN_M} m of an obstacle: "
            "has much been moved, or is the laser mounted elsewhere?"
        )
    if agreement.own_robot:
        yield (
            f"the laser sees its own robot: {agreement.own_robot}; mask them in the driver, or "
            "set bridge.min_range_m above them"
        )
    yield from _of_lasers(agreement)
    lag = agreement.lag
    if lag is not None and abs(lag.lag_s) > max(_LAG_S, _SIGMAS * lag.standard_error_s):
        late = "late" if lag.lag_s > 0.0 else "early"
        yield (
            f"the laser's stamps are {abs(lag.lag_s):.2f} s {late} by odometry's clock: "
            "synchronise the clocks, or correct the offset in the driver"
        )
    if mount is None:
        return
    recorded, found = np.array(agreement.recorded_mount), np.array(mount.robot_from_laser)
    limits = np.maximum(
        (_MOUNT_OFF_M, _MOUNT_OFF_M, _MOUNT_OFF_RAD), _SIGMAS * np.array(mount.standard_errors)
    )
    if (np.abs(found - recorded) > limits).any():
        yield (
            f"the laser's mount is given as {_mount(agreement.recorded_mount)}, the map indicates "
            f"{_mount(mount.robot_from_laser)}"
        )
    scales = (mount.odometry_distance_scale, mount.odometry_turn_scale)
    for scale, error, what in zip(scales, mount.scale_errors, ("drives", "turns"), strict=True):
        if abs(scale - 1.0) > max(_SCALE_OFF, _SIGMAS * error):
            more = "too much" if scale > 1.0 else "too little"
            yield f"odometry {what} {abs(scale - 1.0):.0%} {more}"


def _of_lasers(agreement: Agreement) -> Iterator[str]:
    best = max((share for _, share in agreement.fitting_by_mount), default=0.0)
    for mount, share in agreement.fitting_by_mount:
        if share < _FITTING_SHARE <= best:
            yield (
                f"of the laser {_mount(mount)}, {share:.0%} of the beams end at an obstacle, of "
                f"another {best:.0%}: is it at another height than the map's? Then leave it out"
            )


def _mount(pose: PoseTuple) -> str:
    x, y, heading = pose
    return f"{x:.2f} m ahead, {y:.2f} m left, {math.degrees(heading):.0f} deg"
