"""Converts messages to JSON objects, with units in the names and covariances as 3 x 3 lists."""

from typing import Any

import msgspec

from protocol.advice import Advice
from protocol.answers import Belief, Hypotheses, Hypothesis, PoseAnswer, Status
from protocol.job_events import JobEvents, NumberedEvent
from protocol.message import Covariance, Message, PoseTuple

JsonObject = dict[str, Any]


def dumped(value: JsonObject) -> str:
    """Return an object as one line of JSON; NaN and infinity become null."""
    return msgspec.json.format(msgspec.json.encode(value), indent=0).decode()


def pose_object(pose: PoseTuple, covariance: Covariance) -> JsonObject:
    x_m, y_m, heading_rad = pose
    rows = [list(covariance[row : row + 3]) for row in (0, 3, 6)]
    return {"x_m": x_m, "y_m": y_m, "heading_rad": heading_rad, "covariance": rows}


def hypothesis_object(hypothesis: Hypothesis) -> JsonObject:
    return {
        "cluster": hypothesis.cluster,
        "probability": hypothesis.probability,
        **pose_object(hypothesis.pose, hypothesis.covariance),
        "effective_sample_size": hypothesis.effective_sample_size,
        "age_steps": hypothesis.age_steps,
    }


def belief_object(belief: Belief) -> JsonObject:
    """Convert a belief; ``pose`` and ``probability`` are of the most probable hypothesis."""
    pose, covariance = belief.pose, belief.covariance
    return {
        "step": belief.step,
        "state": belief.state,
        "pose": pose_object(pose, covariance) if pose and covariance else None,
        "probability": belief.probability,
        **_fields(belief, "sender", "term", "odom_from_robot"),
        "hypotheses": [hypothesis_object(hypothesis) for hypothesis in belief.hypotheses],
    }


def pose_answer_object(answer: PoseAnswer) -> JsonObject:
    pose = None
    if answer.pose is not None and answer.covariance is not None:
        pose = pose_object(answer.pose, answer.covariance)
    plain = _fields(answer, "sender", "term", "pose", "covariance")
    return {"state": answer.state, "freshness": answer.freshness, "pose": pose, **plain}


def hypotheses_object(answer: Hypotheses) -> JsonObject:
    places = [hypothesis_object(hypothesis) for hypothesis in answer.hypotheses]
    return {**pose_answer_object(answer.pose), "hypotheses": places}


def advice_object(answer: Advice) -> JsonObject:
    return _fields(answer, "sender")


def event_object(numbered: NumberedEvent) -> JsonObject:
    """Convert an event of a cluster or search to an object without nested objects."""
    plain: JsonObject = msgspec.to_builtins(numbered)
    event: JsonObject = plain.pop("event")
    return {**plain, **event}


def events_object(answer: JobEvents) -> JsonObject:
    return {"term": answer.term, "events": [event_object(event) for event in answer.events]}


def status_object(status: Status) -> JsonObject:
    processes = [
        {"name": process.sender, **_fields(process, "sender")} for process in status.processes
    ]
    return {**_fields(status, "sender", "processes"), "processes": processes}


def _fields(message: Message, *without: str) -> JsonObject:
    """Return the fields of a message, but not its schema and the fields `without`."""
    plain: JsonObject = msgspec.to_builtins(message)
    return {name: value for name, value in plain.items() if name not in ("schema", *without)}
