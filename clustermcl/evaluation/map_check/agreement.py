"""Checks whether a recording matches a map, by localizing and by the fit of its scans."""

import itertools
from collections.abc import Iterable, Sequence

import msgspec
import numpy as np
from scipy.ndimage import distance_transform_edt

from clustermcl.belief.outcome import Outcome
from clustermcl.belief.overlaps import is_near
from clustermcl.changes.collector import ChangeCollector
from clustermcl.evaluation.map_check.look_alikes import refined
from clustermcl.evaluation.map_check.mount import Lag, Mount, lag_of, mount_of
from clustermcl.filter.arrays import OCCUPIED, Points, Poses
from clustermcl.filter.laser.likelihood_field import LikelihoodField
from clustermcl.filter.laser.sensor_model import computed_model
from clustermcl.filter.poses import between, compose
from clustermcl.filter.settings import FilterSettings
from clustermcl.jobs import in_process
from clustermcl.jobs.scan_arrays import scan_beams
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Reading, Scan, mirrored
from clustermcl.recordings.maps.grid_map import GridMap

FITS_WITHIN_M = 0.2
FITS_SHARE = 0.98
"""Share of the beams that end near an obstacle of the right map, after refining the poses."""
ANOTHER_MAP = 0.5
"""Off-map probability above which the recording belongs to another map."""
LEAST_STEPS = 10
"""Least number of steps of one of several lasers whose scans are compared with the map."""
MOST_STEPS, DECOY_STEPS = 400, 160
"""Largest numbers of steps of the recording and of its mirror image: a minute of computation."""


class Agreement(msgspec.Struct, frozen=True, kw_only=True):
    """The result of localizing with a recording."""

    steps: int
    localized_share: float
    fitting_share: float | None
    """Mean share of beams that end within 0.2 m of an obstacle, at steps with one probable place.
    None: there is no such step."""
    recorded_mount: tuple[float, float, float]
    """`robot_from_laser` of the recording or the settings."""
    mount: Mount | None
    """The mount estimated from the map; None: one place was probable too briefly, or the robot
    turned too little."""
    off_map_probability: float
    """Probability that the robot is not on this map, the mean over all steps."""
    decoy_localized_share: float
    """`localized_share` of the mirrored recording, whose robot is not on the map."""
    lag: Lag | None = None
    """How late the laser's stamps are; None: the robot turns too little to tell."""
    own_robot: str = ""
    """Beams that end on the robot itself and are left out; empty: none."""
    fitting_by_mount: tuple[tuple[PoseTuple, float], ...] = ()
    """`fitting_share` of each of several lasers, with its `robot_from_laser`."""

    @property
    def is_of_another_map(self) -> bool:
        """Whether the recording is probably of another map.

        With a wrong laser mount the robot also seems to be off the map, but scans fit once their
        poses are refined.
        """
        fits = self.fitting_share is not None and self.fitting_share > FITS_SHARE
        return self.off_map_probability > ANOTHER_MAP and not fits


def agreement_of(
    scans: Iterable[Scan],
    grid_map: GridMap,
    settings: FilterSettings,
    odometry: Iterable[Reading] = (),
    collector: ChangeCollector | None = None,
) -> Agreement:
    """Localize with the first steps of a recording, and compare its scans with the map.

    The mirrored recording is localized too, as a decoy: a robot that is not on this map. The lag
    of the laser is measured by all readings of `odometry`. The collector gets all steps.
    """
    model = computed_model(grid_map.grid, settings.sensor)
    field = LikelihoodField.build(grid_map.grid, settings.sensor)
    rng = np.random.default_rng(settings.seed)
    run: list[tuple[Poses, Poses, int]] = []
    longest: list[tuple[Poses, Poses, int]] = []
    fitting: list[float] = []
    by_mount: dict[PoseTuple, list[float]] = {}
    localized, off_map, recorded = 0, 0.0, (0.0, 0.0, 0.0)
    to_obstacle_m = distance_transform_edt(grid_map.cells != OCCUPIED) * grid_map.cell_m
    steps = tuple(itertools.islice(scans, MOST_STEPS))
    for scan, outcome in in_process.outcomes(steps, model, settings):
        recorded = scan.robot_from_laser
        if collector is not None:
            collector.on_step(scan, outcome.state, outcome.hypotheses)
        beams = scan_beams(scan, model)
        localized += outcome.state == "localized"
        off_map += outcome.off_map_probability
        if not (_has_one_place(outcome, settings) and beams.count):
            continue
        best = np.array([outcome.hypotheses[0].pose])
        poses, _ = refined(best, beams.hits_in_robot, field, rng)
        fitting.append(_fitting_share(poses[0], beams.hits_in_robot, grid_map, to_obstacle_m))
        own = _fitting_share(poses[0], beams.own_hits_in_robot, grid_map, to_obstacle_m)
        by_mount.setdefault(recorded, []).append(own)
        in_map, by_odometry = compose(poses[0], np.array(recorded)), np.array(scan.odom_from_robot)
        if run and not _continues(run[-1], in_map, by_odometry, settings):
            run = []
        run.append((in_map, by_odometry, scan.stamp_ns))
        longest = max(longest, run, key=len)
    found = np.array([each[:2] for each in longest]).reshape(-1, 2, 3)
    told = [r.detail for scan in steps for r in scan.remarks if r.cause == Cause.OWN_ROBOT]
    mounts = {mount: shares for mount, shares in by_mount.items() if len(shares) >= LEAST_STEPS}
    decoys = in_process.outcomes(map(mirrored, steps[:DECOY_STEPS]), model, settings)
    decoy_localized = [outcome.state == "localized" for _, outcome in decoys]
    return Agreement(
        steps=len(steps),
        localized_share=localized / max(len(steps), 1),
        fitting_share=float(np.mean(fitting)) if fitting else None,
        recorded_mount=recorded,
        mount=mount_of(found[:, 0], found[:, 1]),
        off_map_probability=off_map / max(len(steps), 1),
        decoy_localized_share=float(np.mean(decoy_localized)) if decoy_localized else 0.0,
        lag=_lag(longest, odometry),
        own_robot=told[-1] if told else "",
        fitting_by_mount=tuple((m, float(np.mean(s))) for m, s in mounts.items())
        if len(mounts) > 1
        else (),
    )


def _lag(run: Sequence[tuple[Poses, Poses, int]], readings: Iterable[Reading]) -> Lag | None:
    headings = {r.stamp_ns: r.odom_from_robot[2] for r in readings if r.odom_from_robot is not None}
    if not (run and headings):
        return None
    at_ns = np.array(sorted(headings))
    odometry_rad = np.unwrap([headings[stamp_ns] for stamp_ns in at_ns.tolist()])
    stamps_s = np.array([(stamp_ns - at_ns[0]) * 1e-9 for _, _, stamp_ns in run])
    in_map = np.array([map_from_laser for map_from_laser, _, _ in run])
    return lag_of(in_map, stamps_s, (at_ns - at_ns[0]) * 1e-9, odometry_rad)


def _has_one_place(outcome: Outcome, settings: FilterSettings) -> bool:
    """Return whether the best place is probable, given that the robot is at one of the places."""
    if not outcome.hypotheses:
        return False
    here = 1.0 - outcome.elsewhere_probability
    return outcome.hypotheses[0].probability >= settings.belief.localized_probability * here > 0.0


def _continues(
    last: tuple[Poses, Poses, int], in_map: Poses, by_odometry: Poses, settings: FilterSettings
) -> bool:
    """Return whether a pose is where the last one of a run and odometry say, and no other place."""
    expected = compose(last[0], between(last[1], by_odometry))
    return bool(is_near([in_map], [expected], *settings.search.reach)[0])


def _fitting_share(
    map_from_robot: Poses, hits_in_robot: Points, grid_map: GridMap, to_obstacle_m: np.ndarray
) -> float:
    hits = np.column_stack([hits_in_robot, np.zeros(len(hits_in_robot))])
    in_grid = between(np.array(grid_map.map_from_grid), compose(map_from_robot, hits))
    cols, rows = np.floor(in_grid[:, :2] / grid_map.cell_m).astype(int).T
    height, width = to_obstacle_m.shape
    inside = (rows >= 0) & (cols >= 0) & (rows < height) & (cols < width)
    near = to_obstacle_m[rows[inside], cols[inside]] <= FITS_WITHIN_M
    return float(np.count_nonzero(near) / len(hits))
