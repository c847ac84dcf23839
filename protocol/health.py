"""How each process is: what it does, how often, and what it had to drop."""

import msgspec

from protocol.message import Message


class Health(Message, frozen=True, kw_only=True, tag="health/1"):
    """How one process is. About once a second; losing one makes ``status`` a second older.

    From the bridge on ``bridge/health``, from a worker on ``worker/{name}/health``; read by the
    coordinator, which shows them all in its status, with its own.
    """

    role: str
    """``bridge``, ``worker`` or ``coordinator``."""
    version: str
    """Of the package."""
    uptime_s: float
    """Since its start."""
    memory_bytes: int = 0
    """Resident; 0 where the system does not say."""
    done: dict[str, int] = msgspec.field(default_factory=dict)
    """What it has done since its start: ``scans``, ``steps``, ``reports`` and so on."""
    rates_per_s: dict[str, float] = msgspec.field(default_factory=dict)
    """The same per second, over the last ten seconds."""
    ages_s: dict[str, float] = msgspec.field(default_factory=dict)
    """How long ago it did each last [s]."""
    dropped: dict[str, int] = msgspec.field(default_factory=dict)
    """What it dropped or refused since its start, by cause."""
    age_s: float = 0.0
    """In a status: since this was heard [s]."""
