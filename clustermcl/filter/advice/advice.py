"""Ways for the robot to drive so that scans distinguish its possible places.

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
from scipy.special import ndtr

from clustermcl.filter.advice.roads import SPACING_M, Roads, roads_of
from clustermcl.filter.advice.view_memory import ViewMemory
from clustermcl.filter.arrays import Points, Pose, Poses
from clustermcl.filter.laser.evidence_model import VIEW_M, VIEW_RAD, scan_exponent
from clustermcl.filter.laser.ray_casting import cast_rays_from_poses
from clustermcl.filter.laser.sensor_model import LaserScan, SensorModel
from clustermcl.filter.poses import compose, heading_distance
from clustermcl.filter.settings import FilterSettings

MAX_WAYS = 5
EVIDENCE_NOISE = 0.3
"""Monte Carlo error of the difference in evidence between places [nat]."""
LEAST_INFORMATION = 0.2
"""A way with less information is not advised [nat]."""
LEAST_SHARE = 0.3
"""The same, as a share of the gain if the right place becomes certain; the lower one counts."""
_MAX_SPOTS_OF_MANY, _MANY = 60, 16
"""Largest number of view points for more than `_MANY` places."""
_MAX_PAST, _MAX_PAST_OF_MANY = 100, 20
"""Largest number of earlier views that are predicted, too."""
_OCTANTS = 8
_ALL_ROUND_RAD = 6.0
"""A laser with a larger field of view sees the same in all directions [rad]."""
_SPREADS = 1.5
"""Predicted scans are also weighed at poses this many standard deviations off."""
_LEAST_SIGMAS = np.array([0.05, 0.05, 0.02])
"""Least standard deviations of a place: x, y [m], heading [rad]."""
_COARSE, _FINE = (
    np.stack(np.meshgrid(*[sizes] * 3), axis=-1).reshape(-1, 3)
    for sizes in ((0.0, -1.0, 1.0), (0.0, -1.0, -0.5, 0.5, 1.0))
)
"""(27, 3) and (125, 3) multiples of these; the first is none. Poses are known no better, so a scan
that fits at one of them is no evidence. With the coarse ones, two equal places look different
before the robot has driven; they are for more than `_MANY` places."""
_METRES_PER_RAD = 0.3
"""A turn of one radian costs as much as this distance [m]."""
_BEGINNING_M = 5.0
"""Added to each length for the rate of information, as a way of no length has no rate [m]."""


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
    gains: NDArray[np.float64]
    """(K,) expected gain of the logarithm of each place's probability, if it is right [nat]."""
    information: float
    """Mean of these, weighted by the probability that the place is right [nat]."""
    sure_probability: float
    """Probability that one place has the probability that `localized` needs, after the way."""

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
) -> tuple[list[Way], NDArray[np.float64]]:
    """Find the ways with the most information for their length.

    Args:
        question: the places and the robot.
        model: sensor model of the map.
        settings: rules of evidence.

    Returns:
        At most `MAX_WAYS`, the best for its length first; none if no way within reach has
        `LEAST_INFORMATION`. And (S, 3) the view points: x, y in the robot's frame [m], and the
        expected information of a new view there [nat], the most of all looked at headings.
    """
    roads = roads_of(question.places, question.covariances, question.radius_m, model.grid)
    shares = _shares(question, model, settings)
    views = _views(question, model, settings, roads)
    ways = _ways(question, shares, settings, views)
    return _best(ways, question, shares), _spots(question, shares, views)


def _shares(
    question: Question, model: SensorModel, settings: FilterSettings
) -> NDArray[np.float64]:
    """Return the (K,) probabilities that each place is the right one, which sum to one.

    The likelihood field has no evidence against a place whose obstacles were not seen, so the
    belief keeps it. Here a place that earlier views would have shown to be right has less, so that
    the same obstacle is not looked for again.
    """
    views = question.seen.rows
    most = _MAX_PAST if len(question.places) <= _MANY else _MAX_PAST_OF_MANY
    laser = _thinned(question.laser, settings.sensor.max_beams)
    expected = np.zeros((len(question.places), len(question.places)))
    for view in views[np.argsort(-views[:, 3], kind="stable")[:most]]:
        expected += view[3] * _evidence(view[:3], question, laser, model)
    shares = question.probabilities / question.probabilities.sum()
    others = (1.0 - shares + 1e-9) / (len(shares) - 1)
    found = np.maximum(np.log(shares / others), 0.0)
    missed = np.maximum(np.maximum(expected - expected.T, 0.0) @ shares - found, 0.0)
    shares = shares * np.exp(missed.min() - missed)
    return np.asarray(shares / shares.sum())


View = tuple[int, int]
"""A spot, and the robot's heading there in eighths of a turn."""


@dataclass(frozen=True, eq=False)
class _Views:
    """The ways, with the views that each has."""

    ways: list[tuple[Poses, int, dict[View, tuple[float, float]]]]
    """Poses, how many are sure, and the metres and radians driven with each view."""
    evidence: dict[View, NDArray[np.float64]]
    """(K, K) expected evidence of each view, if it is new; see `_evidence`."""
    spots: NDArray[np.float64]
    """(S, 2) x, y of each spot in the robot's frame [m]."""

    def pose_of(self, view: View) -> Pose:
        """Return the (3,) pose of a view in the robot's frame."""
        return np.array([*self.spots[view[0]], view[1] * math.tau / _OCTANTS])


def _views(
    question: Question, model: SensorModel, settings: FilterSettings, roads: Roads
) -> _Views:
    thin = _thinned(question.laser, settings.sensor.max_beams)
    all_round = np.ptp(thin.angles) + thin.angle_step > _ALL_ROUND_RAD
    targets: Sequence[int] = roads.spots.tolist()
    if len(question.places) > _MANY:
        targets = targets[:: -(-len(targets) // _MAX_SPOTS_OF_MANY)]
    ways = [_driven(roads, target, all_round=bool(all_round)) for target in targets]
    ways = [way for way in ways if way[1] > 1]
    origin = int(roads.spot_of[roads.origin])
    turned = np.zeros((_OCTANTS + 1, 3))
    turned[:, 2] = np.arange(_OCTANTS + 1) * math.tau / _OCTANTS
    headings = {(origin, 0 if all_round else turn): 0.0 for turn in range(_OCTANTS)}
    ways.append((turned, len(turned), dict.fromkeys(headings, (0.0, math.tau / len(headings)))))
    views = _Views(ways, {}, roads.nodes[roads.spots])
    for view in dict.fromkeys(view for *_, driven in ways for view in driven):
        at = views.pose_of(view)
        views.evidence[view] = _evidence(at, question, thin, model)
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


def cast(at: Poses, laser: LaserScan, model: SensorModel) -> NDArray[np.float64]:
    """Return (K, B) ranges of a laser on a robot at (K, 3) poses [m]."""
    longest = min(laser.range_max_m, model.settings.max_range_m)
    map_from_laser = compose(at, laser.robot_from_laser)
    return cast_rays_from_poses(model.jumps, model.grid, map_from_laser, laser.angles, longest)


def _driven(
    roads: Roads, target: int, *, all_round: bool
) -> tuple[Poses, int, dict[View, tuple[float, float]]]:
    nodes = roads.way_to(target)
    along = np.diff(roads.nodes[nodes], axis=0)
    headings = np.arctan2(along[:, 1], along[:, 0])
    poses = np.zeros((len(nodes), 3))
    poses[:, :2] = roads.nodes[nodes]
    poses[1:, 2] = headings
    turns = heading_distance(poses[1:, 2], poses[:-1, 2])
    octants = np.round(headings * _OCTANTS / math.tau).astype(np.int64) % _OCTANTS
    views: dict[View, tuple[float, float]] = {}
    for node, octant, length, turn in zip(
        nodes[1:], octants, np.hypot(along[:, 0], along[:, 1]), turns, strict=True
    ):
        view = int(roads.spot_of[node]), 0 if all_round else int(octant)
        metres, radians = views.get(view, (0.0, 0.0))
        views[view] = metres + float(length), radians + float(turn)
    return poses, roads.count_sure(nodes), views


def _evidence(
    spot: Pose, question: Question, laser: LaserScan, model: SensorModel
) -> NDArray[np.float64]:
    """Predict the scan of each place at a spot, and weigh it at all places.

    Return the (K, K) evidence that will count for the place of the row, against the column's.
    """
    count = len(question.places)
    at = compose(question.places, spot)
    ranges = cast(at, laser, model)
    variances = np.diagonal(question.covariances, axis1=1, axis2=2)
    off = _SPREADS * np.maximum(np.sqrt(np.maximum(variances, 0.0)), _LEAST_SIGMAS)
    offsets = _FINE if count <= _MANY else _COARSE
    poses = (at[:, None] + off[:, None] * offsets).reshape(-1, 3)
    evidence = np.zeros((count, count))
    for k in range(count):
        beams = model.beams(replace(laser, ranges=ranges[k]))
        if beams.count == 0:
            continue  # nothing is in range, so nothing is weighed
        fits = model.log_likelihood(poses, beams).reshape(count, len(offsets)).max(axis=1)
        evidence[k] = scan_exponent(beams.count, model.settings) * np.maximum(fits[k] - fits, 0.0)
    return np.asarray(evidence**2 / (evidence + EVIDENCE_NOISE))


def _ways(
    question: Question, shares: NDArray[np.float64], settings: FilterSettings, views: _Views
) -> list[Way]:
    rules = settings.belief
    per_metre = _new_view(question.gate_m, VIEW_M)
    per_radian = _new_view(question.gate_rad, VIEW_RAD)
    poses = np.array([views.pose_of(view) for view in views.evidence])
    new = dict(zip(views.evidence, question.seen.new_share(poses), strict=True))
    ways = []
    for poses, sure_poses, driven in views.ways:
        total = np.zeros((len(shares), len(shares)))
        for view, (metres, radians) in driven.items():
            total += (metres * per_metre + radians * per_radian) * new[view] * views.evidence[view]
        length = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
        turn = float(heading_distance(poses[1:, 2], poses[:-1, 2]).sum())
        gains, sure = expected_gains(question.probabilities, total, rules.localized_probability)
        information = max(float(shares @ gains), 0.0)
        sure_share = float(question.probabilities.sum() * shares @ sure)
        parts = poses[:sure_poses], poses[sure_poses:]
        ways.append(Way(*parts, length, turn, gains, information, sure_share))
    return ways


def _spots(question: Question, shares: NDArray[np.float64], views: _Views) -> NDArray[np.float64]:
    told = np.zeros(len(views.spots))
    for view, evidence in views.evidence.items():
        gains, _ = expected_gains(question.probabilities, evidence, 0.5)
        told[view[0]] = max(told[view[0]], float(shares @ gains))
    return np.column_stack([views.spots, told])


def _new_view(gate: float, distance: float) -> float:
    """Return the share of a new view that each metre or radian shows (docs/belief.md)."""
    if gate <= 0.0:
        return 1.0 / max(gate, 0.05)
    return -math.expm1(-gate / distance) / gate


def expected_gains(
    probabilities: NDArray[np.float64], evidence: NDArray[np.float64], sure: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what a way gains at each place, and the probability of being sure after it.

    Args:
        probabilities: (K,) of the places; their sum may be below one.
        evidence: (K, K) expected log-likelihood ratio of the row's place and the column's, if the
            row's is right.
        sure: the probability of a place that counts as sure.

    Returns:
        (K,) expected gains of the log probabilities, if the place is right [nat]: their mean over
        the places is the mutual information of place and scans by pairwise distances, between 0
        and the entropy of the places. And (K,) probabilities of being sure then, for which the
        log-likelihood ratio is taken as normal with twice its mean as variance.
    """
    total = float(probabilities.sum())
    log_prior = np.log(probabilities / total)
    log_posterior = log_prior - evidence
    log_sum = np.logaddexp.reduce(log_posterior, axis=1)
    own = np.diagonal(log_posterior)
    rest = log_posterior.copy()
    np.fill_diagonal(rest, -np.inf)
    rival = rest.argmax(axis=1)
    margin = own - np.logaddexp.reduce(rest, axis=1) - math.log(sure / (1.0 - sure))
    spread = np.sqrt(2.0 * evidence[np.arange(len(rival)), rival] + 1e-9)
    return own - log_sum - log_prior, np.asarray(ndtr(margin / spread))


def _best(ways: list[Way], question: Question, shares: NDArray[np.float64]) -> list[Way]:
    """Return the best ways, each ending 2 m or more from those before it.

    Best is the largest sum of two shares for the length: the information of what is missing, and
    the probability of being sure. By the first alone, a robot that is nearly sure is sent to where
    it would learn most if it were wrong.
    """
    prior = question.probabilities / question.probabilities.sum()
    most = max(-float(shares @ np.log(prior)), 1e-9)
    least = min(LEAST_INFORMATION, LEAST_SHARE * most)
    ways = [way for way in ways if way.information >= least]
    ways.sort(
        key=lambda way: (
            -(way.information / most + way.sure_probability) / (way.effort_m + _BEGINNING_M)
        )
    )
    chosen: list[Way] = []
    for way in ways:
        ends = (math.dist(way.end, other.end) for other in chosen)
        if len(chosen) < MAX_WAYS and all(apart >= 2.0 * SPACING_M for apart in ends):
            chosen.append(way)
    return chosen
