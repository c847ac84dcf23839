"""How all processes are, as far as they have said so lately."""

import msgspec

from protocol.health import Health

FORGOTTEN_AFTER_NS = 30_000_000_000
"""Who has said nothing for so long is not listed any more [ns]."""
MAX_PROCESSES = 1_000
"""More names than that are no robot's processes but somebody who makes names up."""


class HealthBoard:
    """Keeps the newest word of each process."""

    def __init__(self) -> None:
        self._heard: dict[str, tuple[int, Health]] = {}

    def heard(self, key: str, health: Health, now_ns: int) -> bool:
        """A process said on its key how it is; False when there are too many to keep."""
        if key not in self._heard and len(self._heard) >= MAX_PROCESSES:
            self._forget(now_ns)
            if len(self._heard) >= MAX_PROCESSES:
                return False
        self._heard[key] = (now_ns, health)
        return True

    def all(self, now_ns: int) -> tuple[Health, ...]:
        """The newest word of each process, with its age, by role and name."""
        self._forget(now_ns)
        ordered = sorted(self._heard.values(), key=lambda told: (told[1].role, told[1].sender))
        return tuple(
            msgspec.structs.replace(health, age_s=(now_ns - heard_ns) / 1e9)
            for heard_ns, health in ordered
        )

    def _forget(self, now_ns: int) -> None:
        self._heard = {
            key: told for key, told in self._heard.items() if now_ns - told[0] < FORGOTTEN_AFTER_NS
        }
