"""Query or command a running system once, or stream from it, and print the answer."""

from collections.abc import Iterable

import msgspec

from clustermcl.as_json import (
    JsonObject,
    belief_object,
    dumped,
    event_object,
    events_object,
    hypotheses_object,
    pose_answer_object,
    status_object,
)
from clustermcl.as_text import (
    belief_line,
    event_line,
    hypotheses_lines,
    pose_lines,
    pose_text,
    status_lines,
)
from clustermcl.client import Client
from process_runtime.logs import is_quiet
from process_runtime.settings import Settings
from protocol.message import Circle, Covariance, PoseTuple


def print_pose(settings: Settings, *, as_json: bool) -> bool:
    """Print the robot's pose; return whether it is known, fresh and not lost."""
    with Client(settings) as client:
        answer = client.pose()
    _print(pose_answer_object(answer) if as_json else pose_lines(answer))
    is_known = answer.map_from_robot is not None
    return is_known and answer.freshness == "fresh" and answer.state != "lost"


def print_hypotheses(settings: Settings, *, above: float, as_json: bool) -> None:
    """Print all places of at least the probability `above`."""
    with Client(settings) as client:
        answer = client.hypotheses()
    kept = tuple(place for place in answer.hypotheses if place.probability >= above)
    answer = msgspec.structs.replace(answer, hypotheses=kept)
    _print(hypotheses_object(answer) if as_json else hypotheses_lines(answer))


def print_status(settings: Settings, *, as_json: bool) -> None:
    with Client(settings) as client:
        answer = client.status()
    _print(status_object(answer) if as_json else status_lines(answer))


def print_events(settings: Settings, *, as_json: bool) -> None:
    """Print the last events of clusters and searches."""
    with Client(settings) as client:
        answer = client.events()
    _print(events_object(answer) if as_json else map(event_line, answer.events))


def follow_events(settings: Settings, *, as_json: bool) -> None:
    """Print the last events, and each new one, until interrupted."""
    with Client(settings) as client:
        for event in client.follow_events():
            _print(event_object(event) if as_json else [event_line(event)])


def watch(settings: Settings, *, as_json: bool) -> None:
    """Print every new belief, until interrupted."""
    with Client(settings) as client:
        for belief in client.beliefs():
            _print(belief_object(belief) if as_json else [belief_line(belief)])


def set_pose(
    settings: Settings,
    map_from_robot: PoseTuple,
    *,
    position_sigma_m: float,
    heading_sigma_rad: float,
    covariance: Covariance | None,
    stamp_ns: int | None,
) -> None:
    with Client(settings) as client:
        client.set_pose(
            map_from_robot,
            position_sigma_m=position_sigma_m,
            heading_sigma_rad=heading_sigma_rad,
            covariance=covariance,
            stamp_ns=stamp_ns,
        )
    _report(settings, f"was given {pose_text(map_from_robot)}")


def relocalize(settings: Settings, near: Circle | None, region: str) -> None:
    """Forget all places and search, everywhere, in a circle or in a region."""
    with Client(settings) as client:
        client.relocalize(near, region)
    where = f"in region {region}" if region else "everywhere"
    if near is not None:
        where = f"within {near[2]:g} m of x {near[0]:g} m  y {near[1]:g} m"
    _report(settings, f"has forgotten all places, and is searched for {where}")


def update(settings: Settings) -> None:
    with Client(settings) as client:
        client.update()
    _report(settings, "makes a step of its next scan")


def kidnap(settings: Settings) -> None:
    with Client(settings) as client:
        client.kidnap()
    _report(settings, "was moved far away")


def _report(settings: Settings, what: str) -> None:
    if not is_quiet():
        _print([f"robot {settings.robot.name!r} {what}"])


def _print(what: JsonObject | Iterable[str]) -> None:
    text = dumped(what) if isinstance(what, dict) else "\n".join(what)
    print(text, flush=True)  # noqa: T201 - the command's answer
