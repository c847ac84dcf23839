"""Promise: a cluster holds the place in each of the rooms that look alike."""

from dataclasses import dataclass

from evaluation.judge import pose_error
from protocol.answers import Belief
from protocol.message import PoseTuple
from soak_test.end_causes import EndCauses
from soak_test.rooms import PLACES, copies_in_all_rooms
from soak_test.true_poses import JudgedBelief
from soak_test.verdict import KEPT_BREAKS, Break, Verdict


@dataclass
class _Loss:
    """A room that no cluster held for a while."""

    room: int
    cause: str
    begin_ns: int
    first_step: int
    end_ns: int
    """Held again, or heard last without."""
    beliefs: int = 0
    found_by: int | None = None
    """The cluster that holds it again."""

    def told(self) -> str:
        """Which room, for how long, and why."""
        lasted = f"{(self.end_ns - self.begin_ns) / 1e9:.1f} s ({self.beliefs} beliefs)"
        back = "" if self.found_by is None else f"; then held by c{self.found_by}"
        return f"room {self.room} at step {self.first_step} for {lasted}: {self.cause}{back}"


def all_rooms_held(judged: JudgedBelief) -> bool:
    """Whether a cluster is where the robot would be in each of the rooms."""
    return all(
        _holder(judged.belief, copy) is not None for copy in copies_in_all_rooms(judged.truth)
    )


class RoomsHeld:
    """A room is held while a cluster is within 1 m and 20 degrees of the true pose's copy in it.

    Counts from the first belief that holds all rooms. Beliefs that no worker has reported to are
    left out: their places are where they were.

    Args:
        causes: told of everything that ends before the beliefs without it.
    """

    def __init__(self, causes: EndCauses) -> None:
        self._causes = causes
        self._holders: list[int] = []
        """The cluster that holds each room, or did last; none until all are held."""
        self._open: dict[int, _Loss] = {}
        self._losses: list[_Loss] = []
        self._beliefs = self._short = 0
        self._fewest = PLACES

    @property
    def complete(self) -> bool:
        """Whether all have been held once: the bootstrap is over."""
        return bool(self._holders)

    def judge(self, judged: JudgedBelief) -> None:
        """A belief was heard whose truth is known."""
        if judged.blind:
            return
        at_ns, belief = judged.at_ns, judged.belief
        copies = copies_in_all_rooms(judged.truth)
        holders = [_holder(belief, copy) for copy in copies]
        held = [cluster for cluster in holders if cluster is not None]
        if not self.complete:
            if len(held) < PLACES:
                return
            self._holders = held
        self._beliefs += 1
        self._short += len(held) < PLACES
        self._fewest = min(self._fewest, len(held))
        for room, cluster in enumerate(holders):
            if cluster is None:
                self._lost(room, copies[room], at_ns, belief)
                continue
            self._holders[room] = cluster
            if (loss := self._open.pop(room, None)) is not None:
                loss.end_ns, loss.found_by = at_ns, cluster

    def verdict(self) -> Verdict:
        """Over all beliefs since all were held; each loss with its room, its time and its cause."""
        longest_s = max(((loss.end_ns - loss.begin_ns) / 1e9 for loss in self._losses), default=0.0)
        lost = f"; {len(self._losses)} lost, longest {longest_s:.1f} s" if self._losses else ""
        return Verdict(
            promise=f"all {PLACES} true places are held",
            target="always",
            measured=f"not in {self._short:,} of {self._beliefs:,} beliefs; fewest {self._fewest}"
            f"{lost}",
            kept=self._beliefs > 0 and not self._short,
            breaks=tuple(Break(loss.begin_ns, loss.told()) for loss in self._losses[:KEPT_BREAKS]),
            figures={
                "short": self._short,
                "beliefs": self._beliefs,
                "fewest": self._fewest,
                "lost": len(self._losses),
                "longest_s": longest_s,
            },
        )

    def _lost(self, room: int, copy: PoseTuple, at_ns: int, belief: Belief) -> None:
        """A room is not held in this belief."""
        if (loss := self._open.get(room)) is None:
            cause = self._cause(self._holders[room], copy, belief)
            loss = self._open[room] = _Loss(room, cause, at_ns, belief.step, at_ns)
            self._losses.append(loss)
        loss.end_ns = at_ns
        loss.beliefs += 1

    def _cause(self, holder: int, copy: PoseTuple, belief: Belief) -> str:
        """Why the cluster that held a room does not any more."""
        for place in belief.hypotheses:
            if place.cluster == holder:
                error = pose_error(place.mean, copy)
                off = f"{error.distance_m:.1f} m and {error.heading_deg:.0f} degrees"
                return f"c{holder} has strayed {off}"
        return self._causes.of(f"c{holder}")


def _holder(belief: Belief, copy: PoseTuple) -> int | None:
    """The most probable cluster that is where the robot would be; a search's places are none."""
    held = (p.cluster for p in belief.hypotheses if pose_error(p.mean, copy).right)
    return next((cluster for cluster in held if cluster >= 0), None)
