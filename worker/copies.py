"""Copies of other workers' clusters, for when those die together with the coordinator."""

from protocol.work import Assignment, WorkOrder, steps_of


class Copies:
    """What the last order wants kept; nothing is computed from it here."""

    def __init__(self) -> None:
        self._kept: dict[str, Assignment] = {}

    @property
    def all(self) -> tuple[Assignment, ...]:
        """The copies, each from where a worker could carry on."""
        return tuple(self._kept.values())

    @property
    def steps(self) -> tuple[tuple[str, int], ...]:
        """(job id, step of its particles) of each."""
        return tuple(sorted(steps_of(self.all).items()))

    def is_news(self, order: WorkOrder) -> bool:
        """Whether an order wants others kept."""
        return bool(order.new_copies) or set(order.copies) != set(self.steps)

    def follow(self, order: WorkOrder) -> None:
        """Keep just what an order names."""
        wanted = set(order.copies)
        known = {copy.job_id: copy for copy in (*self.all, *order.new_copies)}
        self._kept = {
            job_id: copy for job_id, copy in known.items() if wanted & steps_of([copy]).items()
        }
