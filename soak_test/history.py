"""The laws on the history of a run: every decision as the flight recorders wrote it down.

What is heard on the wire is a sample; what coordinators were told and decided is all of it.
"""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path

from coordinator.recorder.replay import Believed, CoordinatorActs, Happening, replayed
from protocol.answers import Belief
from protocol.errors import InputFileError
from soak_test.verdict import KEPT_BREAKS, Break, Verdict

WITHIN = 1e-9
FENCED_WITHIN_S = 2.0
"""A coordinator that was frozen listens before it acts; nobody hears what it decides till then."""


@dataclass
class Rule:
    """One coordinator's, from its first decision to its last."""

    term: int
    begun_ns: int
    took_over: bool
    beliefs: list[tuple[int, Belief]] = field(default_factory=list)
    """With the time by the wall clock."""

    def last_before(self, at_ns: int, heard: int) -> Belief | None:
        """The last belief before somebody else began, of those up to the last that was heard."""
        earlier = [b for told_ns, b in self.beliefs if told_ns < at_ns and b.step <= heard]
        return earlier[-1] if earlier else None


class History:
    """Told all that happened, coordinator by coordinator; says which laws it kept.

    Args:
        heard: by term the last step whose belief anybody has heard. What a coordinator decides
            that is cut off, until it notices, binds nobody.
    """

    def __init__(self, heard: Mapping[int, int]) -> None:
        self._heard = heard
        self._rules: list[Rule] = []
        self._beliefs = self._repeated = 0
        self._other: list[Break] = []
        self._sums: list[Break] = []

    def on(self, at_ns: int, happening: Happening) -> None:
        """Something happened."""
        match happening:
            case CoordinatorActs(_, term, after_step):
                self._rules.append(Rule(term, at_ns, after_step is not None))
            case Believed(belief, same):
                self._beliefs += 1
                self._repeated += same is not None
                if same is False:
                    self._other.append(Break(at_ns, f"another belief of step {belief.step}"))
                here = math.fsum(h.probability for h in belief.hypotheses)
                total = here + belief.elsewhere_probability
                if belief.hypotheses and abs(total - 1.0) > WITHIN:
                    self._sums.append(Break(at_ns, f"{total} at step {belief.step}"))
                if self._rules:
                    self._rules[-1].beliefs.append((at_ns, belief))

    def verdicts(self) -> list[Verdict]:
        """On all laws."""
        alone, goes_on = self._not_alone(), self._not_gone_on()
        terms = f"{len(self._rules)} terms"
        return [
            _verdict("one coordinator rules at a time", terms, alone),
            _verdict("a coordinator begins with all that was told before", terms, goes_on),
            _verdict(
                "told the same once more, a coordinator decides the same",
                f"{self._repeated:,} of {self._beliefs:,} recorded beliefs",
                [*self._other, *self._sums],
                known=self._repeated > 0,
            ),
        ]

    def _not_alone(self) -> list[Break]:
        """Terms that two have had, and decisions long after somebody else had begun to rule."""
        counts = Counter(rule.term for rule in self._rules)
        breaks = [Break(0, f"term {term} was had twice") for term, n in counts.items() if n > 1]
        by_time = sorted(self._rules, key=lambda rule: rule.begun_ns)
        for earlier, later in pairwise(by_time):
            until_ns = later.begun_ns + int(FENCED_WITHIN_S * 1e9)
            late = [told_ns for told_ns, _ in earlier.beliefs if told_ns > until_ns]
            if late and earlier.term < later.term:
                what = f"term {earlier.term} decides on, {later.term} rules"
                breaks.append(Break(late[0], what))
        return breaks

    def _not_gone_on(self) -> list[Break]:
        """Successors that have forgotten a decision, or begin with another.

        One that begins while no worker is there knows nothing yet, and may be told: it counts with
        the first places that it believes in.
        """
        breaks = []
        for earlier, later in pairwise([rule for rule in self._rules if rule.beliefs]):
            last = earlier.last_before(later.begun_ns, self._heard.get(earlier.term, -1))
            if last is None or not _has_places(last):
                continue
            told = [belief for _, belief in later.beliefs]
            first = told[0] if later.took_over else next(filter(_has_places, told), None)
            if first is None or (first.step > last.step and not later.took_over):
                breaks.append(Break(later.begun_ns, f"begins anew after step {last.step}"))
            elif first.stamp_ns < last.stamp_ns:
                what = f"begins with step {first.step}, decided was {last.step}"
                breaks.append(Break(later.begun_ns, what))
            elif first.step == last.step and not _same(first, last):
                breaks.append(Break(later.begun_ns, f"begins with another belief of {last.step}"))
        return breaks


def history_verdicts(recordings: Mapping[Path, Mapping[int, int]]) -> list[Verdict]:
    """On all recordings of a run, one of each robot: the first that kept not all laws, or the last.

    Args:
        recordings: the robots' folders, and what was heard of each: see `History`.
    """
    verdicts: list[Verdict] = []
    for folder, heard in recordings.items():
        history = History(heard)
        try:
            for at_ns, happening in replayed(folder, version("clustermcl")):
                history.on(at_ns, happening)
        except InputFileError as error:
            return [
                _verdict("the flight recording can be read", str(error), [Break(0, str(error))])
            ]
        verdicts = history.verdicts()
        if any(verdict.kept is False for verdict in verdicts):
            break
    return verdicts


def _verdict(promise: str, measured: str, breaks: list[Break], *, known: bool = True) -> Verdict:
    return Verdict(
        promise=promise,
        target="always",
        measured=f"{measured}; {len(breaks)} breaks",
        kept=(not breaks) if known else None,
        breaks=tuple(breaks[:KEPT_BREAKS]),
    )


def _has_places(belief: Belief) -> bool:
    return any(place.cluster >= 0 for place in belief.hypotheses)


def _same(first: Belief, second: Belief) -> bool:
    """Whether two beliefs hold the same places as probable."""
    places = [{p.cluster: p.probability for p in one.hypotheses} for one in (first, second)]
    return places[0].keys() == places[1].keys() and all(
        abs(places[0][cluster] - places[1][cluster]) <= WITHIN for cluster in places[0]
    )
