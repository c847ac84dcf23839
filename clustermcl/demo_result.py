"""The result of a demo, as text and as JSON."""

from dataclasses import dataclass

from clustermcl.as_json import JsonObject, hypothesis_object, pose_object
from clustermcl.as_text import pose_text, spread_text
from clustermcl.demo_summary import DemoSummary
from evaluation.pose_error import PoseError, pose_error
from protocol.answers import Belief, Status
from protocol.message import PoseTuple


@dataclass(frozen=True)
class Result:
    """How a demo ended."""

    summary: DemoSummary
    belief: Belief
    truth: PoseTuple | None
    status: Status


def _error(result: Result) -> PoseError | None:
    if result.truth is None or not result.belief.hypotheses:
        return None
    return pose_error(result.belief.hypotheses[0].mean, result.truth)


def as_object(result: Result, wall_s: float) -> JsonObject:
    """For programs."""
    belief, error = result.belief, _error(result)
    best = belief.hypotheses[0] if belief.hypotheses else None
    return {
        "state": belief.state,
        "pose": pose_object(best.mean, best.covariance) if best else None,
        "probability": best.probability if best else 0.0,
        "elsewhere_probability": belief.elsewhere_probability,
        "off_map_probability": belief.off_map_probability,
        "hypotheses": [hypothesis_object(hypothesis) for hypothesis in belief.hypotheses],
        "steps": result.status.steps_applied,
        "steps_lost": result.status.steps_lost,
        "wall_s": wall_s,
        "final_error_m": error.distance_m if error else None,
        "final_error_rad": error.heading_rad if error else None,
    }


def summary_lines(result: Result, wall_s: float) -> list[str]:
    """For people."""
    belief, error, status = result.belief, _error(result), result.status
    lines = list(result.summary.lines())
    if belief.hypotheses:
        best = belief.hypotheses[0]
        lines.append(
            f"In the end {belief.state} with probability {best.probability:.2f}: "
            f"{pose_text(best.mean)}  {spread_text(best.covariance)}"
        )
    else:
        lines.append(f"In the end {belief.state}, no place is held possible.")
    if error is not None:
        lines.append(f"That is {error.distance_m:.2f} m and {error.heading_deg:.1f} deg off.")
    lines.append(
        f"{status.steps_applied} steps, {status.steps_lost} lost, "
        f"{len(status.workers)} workers, {wall_s:.1f} s."
    )
    return lines
