"""The health of a process: its work, its rates, and what it dropped."""

from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta

from clustermcl.protocol.message import MAX_ID_CHARACTERS, Finite, Message

MAX_WORDS = 500
"""Entries of one table; processes have about twenty."""

MAX_SOURCES = 100
"""Sources of observations that are shown; of more, those that are wrong most often."""

_Word: TypeAlias = Annotated[str, Meta(max_length=MAX_ID_CHARACTERS)]
_Counts: TypeAlias = Annotated[dict[_Word, int], Meta(max_length=MAX_WORDS)]
_Values: TypeAlias = Annotated[dict[_Word, Finite], Meta(max_length=MAX_WORDS)]


class SourceHealth(msgspec.Struct, frozen=True, kw_only=True):
    """What the bridge knows of one source of observations."""

    name: _Word
    """The sender and the landmark, or the sender alone: its poses of the robot."""
    outlier_rate: Finite
    """Expected share of false observations; above one half, the source does not count."""


class Health(Message, frozen=True, kw_only=True, tag="health/1"):
    """The health of one process, published once a second; losing one ages ``status`` by a second.

    Published by the bridge on ``bridge/health`` and by a worker on ``worker/{name}/health``; read
    by the coordinator, which adds its own health and answers with the health of all processes.
    """

    role: str
    """``bridge``, ``worker`` or ``coordinator``."""
    version: str
    """Version of the package."""
    uptime_s: Finite
    """Time since the process started."""
    memory_bytes: int = 0
    """Resident memory; 0: not reported."""
    done: _Counts = msgspec.field(default_factory=dict)
    """Counts since its start: ``scans``, ``steps``, ``reports`` and so on."""
    rates_per_s: _Values = msgspec.field(default_factory=dict)
    """Rates of the same counts over the last ten seconds."""
    ages_s: _Values = msgspec.field(default_factory=dict)
    """Time since each of them last increased [s]."""
    dropped: _Counts = msgspec.field(default_factory=dict)
    """Counts of dropped and refused things since its start, by cause."""
    sources: Annotated[tuple[SourceHealth, ...], Meta(max_length=MAX_SOURCES)] = ()
    """The bridge's sources of observations."""
    gauges: _Values = msgspec.field(default_factory=dict)
    """Present values by name, with their units."""
    age_s: float = 0.0
    """In a status: time since this message arrived [s]."""
