"""A worker's advice: from a belief to ways that distinguish its places."""

import numpy as np
from msgspec.structs import replace

from particle_filter.advice import Question, advised_ways
from particle_filter.evidence_model import residual
from particle_filter.roads import REACH_M
from particle_filter.sensor_model import SensorModel
from particle_filter.settings import FilterSettings
from particle_filter.slices import Slices
from particle_filter.view_memory import ViewMemory
from protocol.advice import Advice, AdviceQuestion, Way
from protocol.pose_arrays import covariance_matrix, pose_tuple
from protocol.steps import Scan
from worker.jobs import scan_beams, scan_of_laser

PROBABLY_ELSEWHERE = 0.5


def advice(
    asked: AdviceQuestion, scan: Scan, model: SensorModel, settings: FilterSettings, sender: str
) -> Slices[Advice]:
    """Compute the answer to a question, in slices.

    Args:
        asked: the belief, of the map of `model`.
        scan: of the step of the belief.
        model: sensor model of the map.
        settings: of the filter.
        sender: name of the process.
    """
    head = Advice(
        sender=sender,
        step=scan.step,
        stamp_ns=scan.stamp_ns,
        odom_from_robot=scan.odom_from_robot,
        clusters=tuple(place.cluster for place in asked.hypotheses),
        places=tuple(place.pose for place in asked.hypotheses),
    )
    count = len(asked.hypotheses)
    if count < 2:
        known = "only one place is possible: there is nothing to distinguish"
        return replace(head, note=known if count else "no place is known yet: first, a search")
    question = _question(asked, scan, model)
    ways, spots = yield from advised_ways(question, model, settings)
    made = tuple(
        Way(
            poses=tuple(map(pose_tuple, way.poses)),
            rest=tuple(map(pose_tuple, way.rest)),
            length_m=way.length_m,
            turn_rad=way.turn_rad,
            gains=tuple(way.gains.tolist()),
            information=way.information,
            sure_probability=min(way.sure_probability, 1.0),
            sight_bearing_rad=way.sight.bearing_rad,
            sight_ranges_m=way.sight.ranges_m,
        )
        for way in ways
    )
    note = ""
    if asked.elsewhere_probability > PROBABLY_ELSEWHERE:
        note = "the robot is probably at another place: drive where a search sees more"
    elif not made and np.hypot(*spots[:, :2].T).max() < 1.0:
        note = f"no way is free at all {count} places"
    elif not made:
        note = f"these {count} places cannot be distinguished within {REACH_M:.0f} m"
    return replace(head, ways=made, note=note, spots=tuple(map(pose_tuple, spots)))


def _question(asked: AdviceQuestion, scan: Scan, model: SensorModel) -> Question:
    places = asked.hypotheses
    poses = np.array([place.pose for place in places])
    beams, fit = scan_beams(scan, model), 0.0
    if beams.count:
        fit = float(model.log_likelihood(poses[:1], beams)[0]) / beams.count
    return Question(
        poses,
        np.array([covariance_matrix(place.covariance) for place in places]),
        np.array([max(place.probability, 1e-12) for place in places]),
        scan_of_laser(scan),
        residual(fit, model.settings) if beams.count else 0.0,
        asked.radius_m,
        ViewMemory(asked.views),
        asked.gate_distance_m,
        asked.gate_turn_rad,
    )
