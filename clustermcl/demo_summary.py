"""The summary of a demo's beliefs and events."""

from collections import Counter
from collections.abc import Iterator

from protocol.answers import Belief
from protocol.job_events import Ended, EndedCause, JobEvent

HELD_PROBABILITY = 0.02
"""A place with less is not worth a person's attention."""


class DemoSummary:
    """Summarizes beliefs and events in constant memory."""

    def __init__(self) -> None:
        self.belief: Belief | None = None
        """The newest."""
        self.localized_since: int | None = None
        """The first step of those, without a gap up to the newest, that were localized."""
        self.ambiguous_steps = 0
        self._first_places_step: int | None = None
        self._most_places = 0
        self._lowest, self._highest = 1.0, 0.0
        self._ended: Counter[EndedCause] = Counter()

    def on_belief(self, belief: Belief) -> None:
        """Take the next belief."""
        self.belief = belief
        held = [h.probability for h in belief.hypotheses if h.probability >= HELD_PROBABILITY]
        if belief.state != "searching" and self._first_places_step is None:
            self._first_places_step = belief.step
        if belief.state == "ambiguous":
            self.ambiguous_steps += 1
            self._most_places = max(self._most_places, len(held))
            self._lowest = min([self._lowest, *held])
            self._highest = max([self._highest, *held])
        if belief.state != "localized":
            self.localized_since = None
        elif self.localized_since is None:
            self.localized_since = belief.step

    def on_event(self, event: JobEvent) -> None:
        """A cluster or a search began or ended."""
        if isinstance(event, Ended) and not event.is_search:
            self._ended[event.cause] += 1

    @property
    def localized_steps(self) -> int:
        """Number of consecutive localized steps."""
        if self.belief is None or self.localized_since is None:
            return 0
        return self.belief.step - self.localized_since + 1

    def lines(self) -> Iterator[str]:
        """The summary as text."""
        if self._first_places_step is not None:
            yield f"The search found its first places at step {self._first_places_step}."
        if self.ambiguous_steps:
            yield (
                f"For {self.ambiguous_steps} steps up to {self._most_places} places were held, "
                f"with probabilities from {self._lowest:.2f} to {self._highest:.2f}."
            )
        if self._ended:
            causes = ", ".join(f"{count} {cause}" for cause, count in self._ended.most_common())
            yield f"Places that were given up: {causes}."
        if self.localized_since is not None:
            yield f"From step {self.localized_since} on one of them was the pose."
