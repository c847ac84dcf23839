"""Converts messages to JSON objects, with units in the names and covariances as 3 x 3 lists."""

from typing import Any, TypeAlias

import msgspec

from clustermcl.protocol.advice import Advice
from clustermcl.protocol.answers import Belief, Hypotheses, Hypothesis, PoseAnswer, Status
from clustermcl.protocol.job_events import JobEvents, NumberedEvent

JsonObject = dict[str, Any]
Answer: TypeAlias = Belief | PoseAnswer | Hypotheses | Advice | JobEvents | NumberedEvent | Status

_LEFT_OUT = {"schema", "sender", "covariance", "why"}


def dumped(value: JsonObject) -> str:
    """Return an object as one line of JSON; NaN and infinity become null."""
    return msgspec.json.format(msgspec.json.encode(value), indent=0).decode()


def json_object(answer: Answer) -> JsonObject:
    """Convert an answer; the pose of a belief or answer is that of its most probable hypothesis."""
    found: JsonObject = msgspec.to_builtins(answer)
    match answer:
        case Belief():
            del found["term"], found["odom_from_robot"]
            found |= {"pose": _pose(answer.best), "probability": answer.probability}
            found |= {"floor": answer.floor, "hypotheses": _places(answer)}
        case PoseAnswer():
            del found["term"]
            found["pose"] = _pose(answer)
        case Hypotheses():
            return {**json_object(answer.pose), "hypotheses": _places(answer)}
        case JobEvents():
            found["events"] = list(map(json_object, answer.events))
        case NumberedEvent():  # without nested objects
            found |= found.pop("event")
        case Status():
            for process in found["processes"]:
                process["name"] = process.pop("sender")
                del process["schema"]
    return {name: value for name, value in found.items() if name not in _LEFT_OUT}


def _places(answer: Belief | Hypotheses) -> list[JsonObject]:
    places: list[JsonObject] = list(msgspec.to_builtins(answer.hypotheses))
    for index, place in enumerate(places):
        del place["pose"], place["log_probability"]
        place.update(_pose(answer.hypotheses[index]) or {})
        place["log_odds_changes_nat"] = answer.why.of(index)
    return places


def _pose(place: Hypothesis | PoseAnswer | None) -> JsonObject | None:
    if place is None or place.pose is None or place.covariance is None:
        return None
    x_m, y_m, heading_rad = place.pose
    rows = [list(place.covariance[row : row + 3]) for row in (0, 3, 6)]
    return {"x_m": x_m, "y_m": y_m, "heading_rad": heading_rad, "covariance": rows}
