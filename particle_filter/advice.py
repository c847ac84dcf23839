"""Ways for the robot to drive so that scans distinguish its possible places (docs/advice.md).

A way is relative to the robot, and lies on ground that is free at every place. At views along it,
scans are predicted for each place by ray casting, and weighed at all other places by the sensor
model and the rules of evidence that will weigh the real scans.

References:
    Fox, Burgard, Thrun, Active Markov localization for mobile robots (1998).
    Kolchinsky, Tracey, Estimating mixture entropy with pairwise distances (2017).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.special import ndtr

from particle_filter.arrays import FREE, Points, Pose, Poses
from particle_filter.evidence_model import evidence_weight, scan_exponent
from particle_filter.grid import Grid
from particle_filter.kernels import plain
from particle_filter.poses import TURN, compose, inverse
from particle_filter.ray_casting import cast_rays_from_poses
from particle_filter.sensor_model import LaserScan, SensorModel
from particle_filter.settings import FilterSettings
from particle_filter.slices import Slices
from particle_filter.view_memory import ViewMemory

REACH_M = 20.0
"""Ways stay within this distance of the robot along x and y [m]."""
MARGIN_M = 0.1
"""Distance that a way keeps from obstacles, beyond the robot's radius [m]."""
MAX_WAYS = 5
LEAST_INFORMATION = 0.2
"""A way with less information is not advised [nat]."""
_LATTICE_M = 0.1
"""Distance between points whose clearance is checked; nodes of ways are twice as far apart [m]."""
_NEAR_M = 0.5
"""Distance from the robot within which a place may have less clearance than required [m]."""
SURE_SIGMAS = 1.0
"""Distance from obstacles, in standard deviations of the position that a way has at a place."""
_DETOUR = 0.2
"""Cost of driving near obstacles: clearance at which a metre costs twice [m]."""
_SPACING_M = 1.0
_MAX_SPOTS, _MAX_SPOTS_OF_MANY, _MANY = 200, 60, 16
"""Largest number of view points: usually, and for more than `_MANY` places."""
_MAX_PAST, _MAX_PAST_OF_MANY = 100, 20
"""Largest number of earlier views that are predicted, too."""
_OCTANTS = 8
_ALL_ROUND_RAD = 6.0
"""A laser with a larger field of view sees the same in all directions [rad]."""
_SPREADS = 1.5
"""Predicted scans are also weighed at poses this many standard deviations off."""
_LEAST_PROBABILITY = 1e-9
_LEAST_SIGMAS = np.array([0.05, 0.05, 0.02])
"""Least standard deviations of a place: x, y [m], heading [rad]."""
_OFFSETS = np.stack(np.meshgrid(*[(0.0, -1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
"""(27, 3) multiples of these; the first is none. Poses are known no better, so a scan
that fits at one of them is no evidence."""
_METRES_PER_RAD = 0.3
"""A turn of one radian costs as much as this distance [m]."""
_BEGINNING_M = 5.0
"""Added to each length for the rate of information, as a way of no length has no rate [m]."""


@dataclass(frozen=True, eq=False)
class Sight:
    """The beam whose range differs most between places, at the end of a way."""

    bearing_rad: float
    """Direction of the beam in the robot's frame at the end of the way [rad]."""
    ranges_m: tuple[float, ...]
    """Predicted range at each place [m]."""


@dataclass(frozen=True, eq=False)
class Way:
    """A way relative to the robot, and its expected information."""

    poses: Poses
    """(n, 3) in the robot's frame, 0.2 m or 0.28 m apart; the first is the robot's."""
    rest: Poses
    """(m, 3) where it leads from there, on ground that is not known well enough yet."""
    length_m: float
    """Length of both [m]."""
    turn_rad: float
    """Sum of all turns [rad]."""
    information: float
    """Expected gain of the logarithm of the right place's probability [nat]."""
    sure_probability: float
    """Probability that one place has the probability that `localized` needs, after the way."""
    sight: Sight

    @property
    def end(self) -> Points:
        """(2,) x, y of the end of the rest [m]."""
        return np.concatenate([self.poses, self.rest])[-1, :2]

    @property
    def effort_m(self) -> float:
        """Length, with turns as metres [m]."""
        return self.length_m + _METRES_PER_RAD * self.turn_rad


@dataclass(frozen=True, eq=False)
class Question:
    """The places, and what is known of robot and laser."""

    places: Poses
    """(K, 3) possible poses of the robot."""
    covariances: NDArray[np.float64]
    """(K, 3, 3) covariances of these."""
    probabilities: NDArray[np.float64]
    """(K,) positive; their sum is the probability that the robot is at one of these places."""
    laser: LaserScan
    """The newest scan; its beams' directions are used."""
    residual: float
    """How much worse than an ideal one the newest scan fits [nat/beam]."""
    radius_m: float
    """Radius of the robot [m]."""
    seen: ViewMemory
    """The robot's earlier views, which later scans from there repeat."""
    gate_m: float
    """Distance between two steps [m]."""
    gate_rad: float
    """Turn between two steps [rad]."""


def advised_ways(
    question: Question, model: SensorModel, settings: FilterSettings
) -> Slices[tuple[list[Way], float]]:
    """Find the ways with the most information for their length.

    Args:
        question: the places and the robot.
        model: sensor model of the map.
        settings: rules of evidence.

    Returns:
        At most `MAX_WAYS`, most information per metre first; none if no way within reach has
        `LEAST_INFORMATION`. And the distance to the farthest view point [m].
    """
    roads = yield from _roads(question, model.grid)
    question = yield from _without_missed(question, model, settings)
    views = yield from _views(question, model, settings, roads)
    reach_m = float(np.hypot(*roads.nodes[roads.spots].T).max())
    return _best(_ways(question, settings, views)), reach_m


def _without_missed(
    question: Question, model: SensorModel, settings: FilterSettings
) -> Slices[Question]:
    """Lower the probabilities of places that earlier views would have shown to be right.

    The likelihood field has no evidence against a place whose obstacles were not seen, so the same
    obstacle would be looked for again.
    """
    views = question.seen.rows
    most = _MAX_PAST if len(question.places) <= _MANY else _MAX_PAST_OF_MANY
    laser = _thinned(question.laser, settings.sensor.max_beams)
    expected = np.zeros((len(question.places), len(question.places)))
    for view in views[np.argsort(-views[:, 3], kind="stable")[:most]]:
        seen = _seen(view[:3], question, laser, model)
        expected += view[3] * _counted(seen, question, settings)
        yield
    total = float(question.probabilities.sum())
    shares = question.probabilities / total
    others = (1.0 - shares + 1e-9) / (len(shares) - 1)
    found = np.maximum(np.log(shares / others), 0.0)
    missed = np.maximum(np.maximum(expected - expected.T, 0.0) @ shares - found, 0.0)
    shares *= np.exp(missed.min() - missed)
    scaled = np.maximum(shares * (total / shares.sum()), _LEAST_PROBABILITY)
    return replace(question, probabilities=scaled)


def _counted(seen: "_Seen", question: Question, settings: FilterSettings) -> NDArray[np.float64]:
    """Return (K, K) how much of the evidence of a view will count."""
    rules = settings.belief
    worth = evidence_weight(1.0, question.residual, rules)
    size = seen.evidence + rules.evidence_noise
    return np.asarray(worth * seen.evidence**2 / np.where(size > 0.0, size, 1.0))


# --- where the robot can drive at all places ----------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Roads:
    """Shortest ways from the robot to all reached nodes, and the spots from which it may look."""

    nodes: NDArray[np.float64]
    """(N, 2) x, y in the robot's frame [m]."""
    before: NDArray[np.int64]
    """(N,) the node before each on its way; negative: the robot's, or not reached."""
    origin: int
    spot_of: NDArray[np.int64]
    """(N,) the spot whose view stands for that of a node; -1: not reached."""
    spots: NDArray[np.int64]
    """(S,) node of each spot."""
    sure: NDArray[np.bool_]
    """(n, n) for points of the lattice: clear of obstacles whatever the errors of the places."""

    def way_to(self, node: int) -> NDArray[np.int64]:
        """Return the (n,) nodes of the way, from the robot's node on."""
        way = [node]
        while way[-1] != self.origin:
            way.append(int(self.before[way[-1]]))
        return np.array(way[::-1])

    def count_sure(self, way: NDArray[np.int64]) -> int:
        """Return how many nodes of a way can be driven to without a new question."""
        rows, cols = np.divmod(way, (len(self.sure) + 1) // 2)
        halfway = self.sure[rows[1:] + rows[:-1], cols[1:] + cols[:-1]]
        return 1 + int(np.argmin(np.append(halfway & self.sure[2 * rows[1:], 2 * cols[1:]], False)))


def _roads(question: Question, grid: Grid) -> Slices[_Roads]:
    side = 2 * round(REACH_M / (2.0 * _LATTICE_M))
    axis = np.arange(-side, side + 1) * _LATTICE_M
    x, y = np.meshgrid(axis, axis)
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    needed = question.radius_m
    near = np.hypot(points[:, 0], points[:, 1]) < _NEAR_M
    clear = np.full(len(points), np.inf)
    drivable, sure = np.ones((2, len(points)), np.bool_)
    for place, covariance in zip(question.places, question.covariances, strict=True):
        room = _clearance(grid, place, points)
        at_robot = room[len(points) // 2]
        as_now = near & (room > max(at_robot - 0.5 * _LATTICE_M, 0.0))
        spread = SURE_SIGMAS * _spread(place, covariance, points)
        here = spread[len(points) // 2]
        drivable &= (room > needed + max(here, MARGIN_M)) | as_now
        sure &= (room > needed + np.maximum(spread, MARGIN_M)) | as_now
        clear = np.minimum(clear, room - spread)
        yield
    drivable[len(points) // 2] = True
    shape = x.shape
    return _shortest(
        drivable.reshape(shape),
        sure.reshape(shape),
        clear.reshape(shape),
        points.reshape(*shape, 3),
    )


def _spread(place: Pose, covariance: NDArray[np.float64], points: Poses) -> NDArray[np.float64]:
    """Return the (P,) largest standard deviation of the position that points have in the map [m].

    An error of the heading displaces a point in proportion to its distance.

    Args:
        place: (3,) the robot's pose in the map.
        covariance: (3, 3) of that pose.
        points: (P, 3) in the robot's frame.
    """
    x, y, _ = (compose(place, points) - place).T
    (xx, xy, xh), (_, yy, yh), (_, _, hh) = covariance
    along_x = xx - 2.0 * y * xh + y**2 * hh
    along_y = yy + 2.0 * x * yh + x**2 * hh
    both = xy + x * xh - y * yh - x * y * hh
    apart = np.hypot(0.5 * (along_x - along_y), both)
    return np.asarray(np.sqrt(np.maximum(0.5 * (along_x + along_y) + apart, 0.0)))


def _clearance(grid: Grid, place: Pose, points: Poses) -> NDArray[np.float64]:
    """Return the (P,) distance from points to ground that is not known to be free [m].

    Args:
        grid: the map; only the surroundings of the points are read.
        place: the robot's pose in the map.
        points: (P, 3) in the robot's frame.
    """
    c, s, x0, y0 = grid.in_cells
    in_map = compose(place, points)
    cols = np.floor(c * in_map[:, 0] - s * in_map[:, 1] + x0).astype(np.int64)
    rows = np.floor(s * in_map[:, 0] + c * in_map[:, 1] + y0).astype(np.int64)
    stride = max(round(_LATTICE_M / grid.cell_m), 1)
    first_row, first_col = int(rows.min()), int(cols.min())
    high, wide = int(np.ptp(rows)) // stride + 1, int(np.ptp(cols)) // stride + 1
    blocked = np.ones((high * stride, wide * stride), np.bool_)
    top, left = max(first_row, 0), max(first_col, 0)
    part = grid.cells[top : first_row + len(blocked), left : first_col + blocked.shape[1]]
    if part.size and first_row + len(blocked) > 0 and first_col + blocked.shape[1] > 0:
        row, col = top - first_row, left - first_col
        blocked[row : row + part.shape[0], col : col + part.shape[1]] = part != FREE
    blocks = np.asarray(blocked.reshape(high, stride, wide, stride).any(axis=(1, 3)))
    # Half a block is subtracted, because the obstacle may begin at the block's border.
    room_m = (distance_transform_edt(np.logical_not(blocks)) - 0.5) * (stride * grid.cell_m)
    return np.asarray(room_m[(rows - first_row) // stride, (cols - first_col) // stride])


def _shortest(
    drivable: NDArray[np.bool_],
    sure: NDArray[np.bool_],
    clear: NDArray[np.float64],
    points: NDArray[np.float64],
) -> _Roads:
    """Connect every second point of the lattice, if the points between them are free, too."""
    size = (len(drivable) + 1) // 2
    number = np.arange(size * size).reshape(size, size)
    begins, ends, costs = [], [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        rows, cols = np.mgrid[0 : size - down, max(-right, 0) : size - max(right, 0)]
        at, to = (2 * rows, 2 * cols), (2 * (rows + down), 2 * (cols + right))
        half = (2 * rows + down, 2 * cols + right)
        open_ = drivable[at] & drivable[half] & drivable[to]
        room = np.maximum(clear[half][open_], 0.05)
        begins.append(number[rows, cols][open_])
        ends.append(number[rows + down, cols + right][open_])
        costs.append(2.0 * _LATTICE_M * math.hypot(down, right) * (1.0 + _DETOUR / room))
    count, origin = size * size, size * size // 2
    edges = (np.concatenate(costs), (np.concatenate(begins), np.concatenate(ends)))
    graph = coo_array(edges, shape=(count, count)).tocsr()
    graph = csr_array(graph + graph.T)
    lengths, befores = dijkstra(graph, indices=[origin], return_predecessors=True)
    length, before = lengths[0], befores[0]
    nodes = points[::2, ::2, :2].reshape(-1, 2)
    reached = np.flatnonzero(np.isfinite(length))
    spots, spot_of = _spots(nodes, reached, clear[::2, ::2].reshape(-1), origin)
    return _Roads(nodes, np.asarray(before, np.int64), origin, spot_of, spots, sure)


def _spots(
    nodes: NDArray[np.float64], reached: NDArray[np.int64], clear: NDArray[np.float64], origin: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Choose the roomiest node of each square as a spot, in about `_MAX_SPOTS` squares."""
    area = len(reached) * (2.0 * _LATTICE_M) ** 2
    side = max(_SPACING_M, math.sqrt(area / _MAX_SPOTS))
    squares = np.round(nodes[reached] / side).astype(np.int64)
    _, square = np.unique(squares, axis=0, return_inverse=True)
    order = np.lexsort((-clear[reached], square.ravel()))
    _, first = np.unique(square.ravel()[order], return_index=True)
    spots = reached[order[first]]
    spots[square.ravel()[np.searchsorted(reached, origin)]] = origin
    spot_of = np.full(len(nodes), -1)
    spot_of[reached] = square.ravel()
    return spots, spot_of


# --- scans that are expected there ----------------------------------------------------------------

View = tuple[int, int]
"""A spot, and the robot's heading there in eighths of a turn."""


@dataclass(frozen=True, eq=False)
class _Seen:
    """The evidence and the ranges that are expected at a view."""

    evidence: NDArray[np.float64]
    """(K, K) expected evidence of one new view for the place of the row, against the column's."""
    ranges: NDArray[np.float64]
    """(K, B) predicted ranges [m]."""


@dataclass(frozen=True, eq=False)
class _Views:
    """The ways, with the views that each has."""

    ways: list[tuple[Poses, int, dict[View, tuple[float, float]]]]
    """Poses, how many are sure, and the metres and radians driven with each view."""
    seen: dict[View, _Seen]
    spots: NDArray[np.float64]
    """(S, 2) x, y of each spot in the robot's frame [m]."""
    angles: NDArray[np.float64]
    """(B,) directions of the predicted beams in the robot's frame [rad]."""

    def pose_of(self, view: View) -> Pose:
        """Return the (3,) pose of a view in the robot's frame."""
        return np.array([*self.spots[view[0]], view[1] * TURN / _OCTANTS])


def _views(
    question: Question, model: SensorModel, settings: FilterSettings, roads: _Roads
) -> Slices[_Views]:
    thin = _thinned(question.laser, settings.sensor.max_beams)
    angles = _angles(thin)
    all_round = np.ptp(angles) + thin.angle_step > _ALL_ROUND_RAD
    targets: Sequence[int] = roads.spots.tolist()
    if len(question.places) > _MANY:
        targets = targets[:: -(-len(targets) // _MAX_SPOTS_OF_MANY)]
    ways = [_driven(roads, target, all_round=bool(all_round)) for target in targets]
    ways = [way for way in ways if way[1] > 1]
    origin = int(roads.spot_of[roads.origin])
    turned = np.zeros((_OCTANTS + 1, 3))
    turned[:, 2] = np.arange(_OCTANTS + 1) * TURN / _OCTANTS
    headings = {(origin, 0 if all_round else turn): 0.0 for turn in range(_OCTANTS)}
    ways.append((turned, len(turned), dict.fromkeys(headings, (0.0, TURN / len(headings)))))
    views = _Views(ways, {}, roads.nodes[roads.spots], angles + thin.robot_from_laser[2])
    for view in dict.fromkeys(view for *_, driven in ways for view in driven):
        views.seen[view] = _seen(views.pose_of(view), question, thin, model)
        yield
    return views


def _thinned(laser: LaserScan, max_beams: int) -> LaserScan:
    """Return every n-th beam of the first laser, so that at most twice `max_beams` remain."""
    stride = max(len(laser.ranges) // max_beams, 1)
    first = stride // 2
    return replace(
        laser, ranges=np.asarray(laser.ranges[first::stride], np.float64), others=(),
        angle_min=laser.angle_min + first * laser.angle_step,
        angle_step=stride * laser.angle_step,
    )  # fmt: skip


def _angles(laser: LaserScan) -> NDArray[np.float64]:
    return np.asarray(laser.angle_min + laser.angle_step * np.arange(len(laser.ranges)), np.float64)


def _longest(question: Question, model: SensorModel) -> float:
    return min(question.laser.range_max_m, model.settings.max_range_m)


def _cast(at: Poses, laser: LaserScan, longest: float, model: SensorModel) -> NDArray[np.float64]:
    """Return (K, B) ranges of a laser on a robot at (K, 3) poses [m]."""
    grid = model.grid
    in_grid = compose(inverse(grid.map_from_grid), compose(at, laser.robot_from_laser))
    return cast_rays_from_poses(model.jumps, grid.cell_m, in_grid, _angles(laser), longest)


def _driven(
    roads: _Roads, target: int, *, all_round: bool
) -> tuple[Poses, int, dict[View, tuple[float, float]]]:
    nodes = roads.way_to(target)
    along = np.diff(roads.nodes[nodes], axis=0)
    headings = np.arctan2(along[:, 1], along[:, 0])
    poses = np.zeros((len(nodes), 3))
    poses[:, :2] = roads.nodes[nodes]
    poses[1:, 2] = headings
    turns = np.abs((np.diff(poses[:, 2]) + math.pi) % TURN - math.pi)
    octants = np.round(headings * _OCTANTS / TURN).astype(np.int64) % _OCTANTS
    views: dict[View, tuple[float, float]] = {}
    for node, octant, length, turn in zip(
        nodes[1:], octants, np.hypot(along[:, 0], along[:, 1]), turns, strict=True
    ):
        view = int(roads.spot_of[node]), 0 if all_round else int(octant)
        metres, radians = views.get(view, (0.0, 0.0))
        views[view] = metres + float(length), radians + float(turn)
    return poses, roads.count_sure(nodes), views


def _seen(spot: Pose, question: Question, laser: LaserScan, model: SensorModel) -> _Seen:
    """Predict the scan of each place at a spot, and weigh it at all places."""
    count = len(question.places)
    at = compose(question.places, spot)
    ranges = _cast(at, laser, _longest(question, model), model)
    variances = np.diagonal(question.covariances, axis1=1, axis2=2)
    off = _SPREADS * np.maximum(np.sqrt(np.maximum(variances, 0.0)), _LEAST_SIGMAS)
    poses = plain((at[:, None] + off[:, None] * _OFFSETS).reshape(-1, 3))
    evidence = np.zeros((count, count))
    for k in range(count):
        beams = model.beams(replace(laser, ranges=ranges[k]))
        if beams.count == 0:
            continue  # nothing is in range, so nothing is weighed
        fits = model.log_likelihood(poses, beams).reshape(count, len(_OFFSETS)).max(axis=1)
        evidence[k] = scan_exponent(beams.count, model.settings) * np.maximum(fits[k] - fits, 0.0)
    return _Seen(evidence, ranges)


# --- their information --------------------------------------------------------------------------


def _ways(question: Question, settings: FilterSettings, views: _Views) -> list[Way]:
    rules = settings.belief
    per_metre = _new_view(question.gate_m, rules.view_distance_m)
    per_radian = _new_view(question.gate_rad, rules.view_turn_rad)
    poses = np.array([views.pose_of(view) for view in views.seen])
    new = dict(zip(views.seen, question.seen.new_share(poses, rules), strict=True))
    informs = {view: _counted(seen, question, settings) for view, seen in views.seen.items()}
    ways = []
    for poses, sure_poses, driven in views.ways:
        total = np.zeros_like(next(iter(informs.values())))
        for view, (metres, radians) in driven.items():
            total += (metres * per_metre + radians * per_radian) * new[view] * informs[view]
        length = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
        turn = float(np.abs((np.diff(poses[:, 2]) + math.pi) % TURN - math.pi).sum())
        information, sure = information_of(
            question.probabilities, total, rules.localized_probability
        )
        last = max(driven, key=lambda view: float(informs[view].sum()))
        parts = poses[:sure_poses], poses[sure_poses:]
        ways.append(Way(*parts, length, turn, information, sure, _sight(views, last, question)))
    return ways


def _new_view(gate: float, distance: float) -> float:
    """Return the share of a new view that each metre or radian shows (docs/evidence.md)."""
    if distance <= 0.0 or gate <= 0.0:
        return 1.0 / max(gate, 0.05)
    return -math.expm1(-gate / distance) / gate


def information_of(
    probabilities: NDArray[np.float64], evidence: NDArray[np.float64], sure: float
) -> tuple[float, float]:
    """Return the expected information of a way, and the probability of being sure after it.

    Args:
        probabilities: (K,) of the places; their sum may be below one.
        evidence: (K, K) expected log-likelihood ratio of the row's place and the column's, if the
            row's is right.
        sure: the probability of a place that counts as sure.

    Returns:
        The mutual information of place and scans by pairwise distances [nat], between 0 and the
        entropy of the places; and a probability, for which the log-likelihood ratio is taken as
        normal with twice its mean as variance.
    """
    total = float(probabilities.sum())
    log_prior = np.log(probabilities / total)
    log_posterior = log_prior - evidence
    log_sum = np.logaddexp.reduce(log_posterior, axis=1)
    own = np.diagonal(log_posterior)
    information = float((probabilities / total) @ (own - log_sum - log_prior))
    rest = log_posterior.copy()
    np.fill_diagonal(rest, -np.inf)
    rival = rest.argmax(axis=1)
    margin = own - np.logaddexp.reduce(rest, axis=1) - math.log(sure / (1.0 - sure))
    spread = np.sqrt(2.0 * evidence[np.arange(len(rival)), rival] + 1e-9)
    return max(information, 0.0), float(probabilities @ ndtr(margin / spread))


def _sight(views: _Views, view: View, question: Question) -> Sight:
    """Return the beam with the largest spread of ranges over the places."""
    ranges = views.seen[view].ranges
    shares = question.probabilities / question.probabilities.sum()
    variance = shares @ (ranges - shares @ ranges) ** 2
    beam = int(variance.argmax())
    bearing = (float(views.angles[beam]) + math.pi) % TURN - math.pi
    return Sight(bearing, tuple(ranges[:, beam].tolist()))


def _best(ways: list[Way]) -> list[Way]:
    """Return the best ways, each ending 2 m or more from those before it."""
    ways = [way for way in ways if way.information >= LEAST_INFORMATION]
    ways.sort(key=lambda way: -way.information / (way.effort_m + _BEGINNING_M))
    chosen: list[Way] = []
    for way in ways:
        ends = (math.dist(way.end, other.end) for other in chosen)
        if len(chosen) < MAX_WAYS and all(apart >= 2.0 * _SPACING_M for apart in ends):
            chosen.append(way)
    return chosen
