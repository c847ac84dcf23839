"""Why clusters ended, as the coordinator told it."""

from protocol.job_events import Ended, JobEvents, event_text

_KEPT_ENDS = 200


class EndCauses:
    """Told of what has begun and ended; knows of the last jobs why they ended."""

    def __init__(self) -> None:
        self._ends: dict[str, str] = {}

    def on_events(self, events: JobEvents) -> None:
        """Something has begun or ended."""
        for numbered in events.events:
            if isinstance(numbered.event, Ended):
                self._ends[numbered.event.job_id] = event_text(numbered.event)
        while len(self._ends) > _KEPT_ENDS:
            del self._ends[next(iter(self._ends))]

    def of(self, job_id: str) -> str:
        """Why a job is not there any more."""
        return self._ends.get(job_id, f"{job_id} has gone, nobody said why")
