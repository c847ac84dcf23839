"""A worker's advice: from a belief to ways that distinguish its places."""

import numpy as np
from msgspec.structs import replace

from clustermcl.filter.advice.advice import Question, advised_ways
from clustermcl.filter.advice.roads import LEAST_REACH_M, REACH_M
from clustermcl.filter.advice.view_memory import ViewMemory
from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.filter.settings import FilterSettings
from clustermcl.jobs.scan_arrays import scan_of_laser
from clustermcl.protocol.advice import Advice, AdviceQuestion, Way
from clustermcl.protocol.pose_arrays import covariance_matrix, pose_tuple
from clustermcl.protocol.steps import Scan

LOST = "the robot is probably at another place: wait for the search"


def advice(
    asked: AdviceQuestion, scan: Scan, model: SensorModel, settings: FilterSettings, sender: str
) -> Advice:
    """Answer a question about the belief after the step of a scan, in the map of the model."""
    head = Advice(
        sender=sender,
        step=scan.step,
        stamp_ns=scan.stamp_ns,
        odom_from_robot=scan.odom_from_robot,
        clusters=tuple(place.cluster for place in asked.hypotheses),
        places=tuple(place.pose for place in asked.hypotheses),
    )
    count = len(asked.hypotheses)
    is_lost = asked.elsewhere_probability > settings.belief.lost_probability
    if count < 2:
        known = "only one place is possible: there is nothing to distinguish"
        note = LOST if is_lost else known if count else "no place is known yet: first, a search"
        return replace(head, note=note)
    ways, spots = advised_ways(_question(asked, scan), model, settings)
    made = tuple(
        Way(
            poses=tuple(map(pose_tuple, way.poses)),
            rest=tuple(map(pose_tuple, way.rest)),
            length_m=way.length_m,
            gains=tuple(way.gains.tolist()),
            information=way.information,
            sure_probability=min(way.sure_probability, 1.0),
        )
        for way in ways
    )
    note = ""
    if is_lost:
        note = LOST
    elif np.hypot(*spots[:, :2].T).max() < LEAST_REACH_M:
        note = f"no ground is free at all {count} places"
    elif not made:
        note = f"these {count} places cannot be distinguished within {REACH_M:.0f} m"
    return replace(head, ways=made, note=note, spots=tuple(map(pose_tuple, spots)))


def _question(asked: AdviceQuestion, scan: Scan) -> Question:
    places = asked.hypotheses
    poses = np.array([place.pose for place in places])
    return Question(
        poses,
        np.array([covariance_matrix(place.covariance) for place in places]),
        np.array([max(place.probability, 1e-12) for place in places]),
        scan_of_laser(scan),
        asked.radius_m,
        ViewMemory(asked.views),
        asked.gate_distance_m,
        asked.gate_turn_rad,
    )
