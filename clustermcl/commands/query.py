"""The commands that query a running system, and print the answer."""

import logging
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import msgspec

from clustermcl.commands import as_text as text
from clustermcl.commands import options as opt
from clustermcl.commands.as_json import json_object
from clustermcl.protocol.job_events import NumberedEvent, probability_of
from clustermcl.runtime.settings import Settings

EXIT_NO_POSE = 4


@opt.client_command
def pose(settings: Settings, as_json: opt.AsJson = False) -> None:
    """Print the robot's pose, its uncertainty, and the age of the data.

    Exit code 4 if the pose is not safe to drive by: stale, dead reckoning, lost, or unknown.
    """
    with opt.connected(settings) as client:
        answer = client.pose()
    opt.print_answer(json_object(answer) if as_json else text.pose_lines(answer))
    if answer.pose is None or answer.freshness != "fresh" or answer.state == "lost":
        sys.exit(EXIT_NO_POSE)


@opt.client_command
def hypotheses(
    settings: Settings,
    above: opt.Above = 0.0,
    why: Annotated[bool, opt.flag("--why", "Also why each probability changed.")] = False,
    as_json: opt.AsJson = False,
) -> None:
    """Print all places where the robot may be, with probabilities."""
    with opt.connected(settings) as client:
        answer = client.hypotheses()
    kept = tuple(place for place in answer.hypotheses if place.probability >= above)
    answer = msgspec.structs.replace(answer, hypotheses=kept)
    opt.print_answer(json_object(answer) if as_json else text.hypotheses_lines(answer, why=why))


@opt.client_command
def advise(settings: Settings, as_json: opt.AsJson = False) -> None:
    """Print where to drive so that scans distinguish the possible places."""
    with opt.connected(settings) as client:
        answer = client.advice()
    opt.print_answer(json_object(answer) if as_json else text.advice_lines(answer))


@opt.client_command
def events(
    settings: Settings,
    follow: Annotated[bool, opt.flag("--follow", "Also print new events, until Ctrl-C.")] = False,
    above: opt.Above = 0.0,
    as_json: opt.AsJson = False,
) -> None:
    """Print what began and ended and why, commands, and faults of sensors."""

    def is_shown(numbered: NumberedEvent) -> bool:
        return probability_of(numbered.event) >= above

    if follow:
        with _until_interrupted(), opt.connected(settings) as client:
            for event in filter(is_shown, client.follow_events()):
                opt.print_answer(json_object(event) if as_json else [text.event_line(event)])
        return
    with opt.connected(settings) as client:
        answer = client.events()
    answer = msgspec.structs.replace(answer, events=tuple(filter(is_shown, answer.events)))
    opt.print_answer(json_object(answer) if as_json else text.event_lines(answer.events))


@opt.client_command
def status(settings: Settings, as_json: opt.AsJson = False) -> None:
    """Print steps, workers, and counts of dropped data."""
    with opt.connected(settings) as client:
        answer = client.status()
    opt.print_answer(json_object(answer) if as_json else text.status_lines(answer))


@opt.client_command
def watch(settings: Settings, as_json: opt.AsJson = False) -> None:
    """Print each new belief, until Ctrl-C."""
    with _until_interrupted(), opt.connected(settings) as client:
        for belief in client.beliefs():
            opt.print_answer(json_object(belief) if as_json else [text.belief_line(belief)])


@contextmanager
def _until_interrupted() -> Iterator[None]:
    """Run an endless ``with`` block until Ctrl-C."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:
        logging.getLogger(__name__).debug("interrupted")
