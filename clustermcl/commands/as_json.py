"""Converts messages to JSON objects, with units in the names and covariances as 3 x 3 lists."""

from typing import Any, TypeAlias, assert_never

import msgspec

from clustermcl.protocol.advice import Advice
from clustermcl.protocol.answers import Belief, Hypotheses, Hypothesis, PoseAnswer, Status
from clustermcl.protocol.job_events import JobEvents, NumberedEvent
from clustermcl.protocol.message import Covariance, Message, PoseTuple

JsonObject = dict[str, Any]
Answer: TypeAlias = Belief | PoseAnswer | Hypotheses | Advice | JobEvents | NumberedEvent | Status


def dumped(value: JsonObject) -> str:
    """Return an object as one line of JSON; NaN and infinity become null."""
    return msgspec.json.format(msgspec.json.encode(value), indent=0).decode()


def json_object(answer: Answer | Hypothesis) -> JsonObject:
    """Convert an answer; the pose of a belief or answer is that of its most probable hypothesis."""
    found: JsonObject
    match answer:
        case Belief():
            best = answer.best
            found = {
                "step": answer.step,
                "state": answer.state,
                "pose": _pose(best.pose, best.covariance) if best else None,
                "probability": answer.probability,
                "floor": answer.floor,
                **_fields(answer, "sender", "term", "odom_from_robot", "why"),
                "hypotheses": _places(answer),
            }
        case PoseAnswer():
            pose = _pose(answer.pose, answer.covariance)
            plain = _fields(answer, "sender", "term", "pose", "covariance")
            found = {"state": answer.state, "freshness": answer.freshness, "pose": pose, **plain}
        case Hypotheses():
            found = {**json_object(answer.pose), "hypotheses": _places(answer)}
        case Hypothesis():
            found = {
                "cluster": answer.cluster,
                "probability": answer.probability,
                "floor": answer.floor,
                **(_pose(answer.pose, answer.covariance) or {}),
                "effective_sample_size": answer.effective_sample_size,
                "age_steps": answer.age_steps,
            }
        case Advice():
            found = _fields(answer, "sender")
        case JobEvents():
            found = {"term": answer.term, "events": list(map(json_object, answer.events))}
        case NumberedEvent():  # without nested objects
            found = msgspec.to_builtins(answer)
            found |= found.pop("event")
        case Status():
            processes = [{"name": one.sender, **_fields(one, "sender")} for one in answer.processes]
            found = {**_fields(answer, "sender", "processes"), "processes": processes}
        case other:
            assert_never(other)
    return found


def _places(answer: Belief | Hypotheses) -> list[JsonObject]:
    return [
        json_object(place) | {"log_odds_changes_nat": answer.why.of(index)}
        for index, place in enumerate(answer.hypotheses)
    ]


def _pose(pose: PoseTuple | None, covariance: Covariance | None) -> JsonObject | None:
    if pose is None or covariance is None:
        return None
    x_m, y_m, heading_rad = pose
    rows = [list(covariance[row : row + 3]) for row in (0, 3, 6)]
    return {"x_m": x_m, "y_m": y_m, "heading_rad": heading_rad, "covariance": rows}


def _fields(message: Message, *without: str) -> JsonObject:
    """Return the fields of a message, but not its schema and the fields `without`."""
    plain: JsonObject = msgspec.to_builtins(message)
    return {name: value for name, value in plain.items() if name not in ("schema", *without)}
