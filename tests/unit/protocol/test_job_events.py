import math
from typing import get_args

import pytest

from clustermcl.protocol.causes import Cause
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.job_events import (
    Began,
    BeganCause,
    Ended,
    EndedCause,
    JobEvent,
    JobEvents,
    NumberedEvent,
    Remark,
    event_text,
    event_texts,
)


def message_of(*events: JobEvent) -> JobEvents:
    numbered = (
        NumberedEvent(number=n, step=3, stamp_ns=7, event=event) for n, event in enumerate(events)
    )
    return JobEvents(sender="coordinator", events=tuple(numbered), term=4)


def test_many_events_of_one_cause_share_a_line() -> None:
    found = [Began(f"c{number}", "first search", 0.5**number) for number in range(1, 6)]
    replaced = [Ended(f"c{number}", "pushed out", ("c9",), 0.01) for number in range(4)]
    few = [Ended("c3", "merged", ("c1",), 1e-5)] * 2
    shards = [Ended(f"s2.{number}", "search over") for number in range(4)]
    silent = Remark(cause="laser silent", detail="for 3.1 s")
    assert list(event_texts(message_of(*found, *replaced, *few, *shards, silent).events)) == [
        "step 3: 5 places found by the first search (50 % to 3.1 %)",
        "step 3: 4 places replaced by others (1.0 %)",
        *["step 3: place 3 merged into place 1 (< 0.1 %)"] * 2,
        "step 3: search 2 is over",
        "step 3: laser silent: for 3.1 s",
    ]


def test_every_cause_survives_encoding_and_has_a_text() -> None:
    began = [Began("c1", cause, 0.5) for cause in get_args(BeganCause)]
    ended = [Ended("c1", cause, ("c2",), 0.5) for cause in get_args(EndedCause)]
    message = message_of(*began, *ended, *(Remark(cause=cause) for cause in Cause))
    assert decode(encode(message), JobEvents) == message
    assert len({event_text(event) for event in (*began, *ended)}) == len(began) + len(ended)


@pytest.mark.parametrize(
    "event",
    [
        Began("c1", "given", math.nan),
        Ended("c1", "improbable", (), -0.1),
        Began("c" * 200, "given", 0.5),
        Ended("c1", "merged", ("c" * 200,), 0.5),
        Ended("c1", "no such cause", (), 0.5),  # type: ignore[arg-type] # that is it
    ],
)
def test_an_impossible_event_is_refused(event: JobEvent) -> None:
    with pytest.raises(MalformedMessageError):
        decode(encode(message_of(event)), JobEvents)
