"""Promise: the clusters of a worker that is killed or frozen go on somewhere else, soon."""

from collections.abc import Iterable
from dataclasses import dataclass

from soak_test.availability import BACK_WITHIN_S, Availability, DoneFault
from soak_test.schedule import Kind
from soak_test.verdict import KEPT_BREAKS, Break, Verdict

WITHIN_S = {
    Kind.WORKER_KILLED: 2.0,
    Kind.WORKER_FROZEN: 5.0,
    Kind.WORKER_LINKS_CUT: 5.0,
    Kind.ALL_WORKERS_KILLED: 15.0,
}
"""A killed worker's link breaks at once, that of one frozen or cut off after its lease of 2 s; to
start workers anew takes some seconds."""
_REPORTED_LATELY_NS = 2_000_000_000
_IN_FLIGHT_NS = 100_000_000
"""Reports sent just before the death."""


@dataclass(frozen=True)
class _Orphan:
    job_id: str
    worker: str
    fault: DoneFault


class Recovery:
    """Told of reports, beliefs and faults; knows which clusters are waited for."""

    def __init__(self, availability: Availability) -> None:
        self._availability = availability
        self._reporter: dict[str, tuple[str, int]] = {}
        self._orphans: dict[str, _Orphan] = {}
        self._took_s: dict[Kind, list[float]] = {kind: [] for kind in WITHIN_S}
        self._late: dict[Kind, list[Break]] = {kind: [] for kind in WITHIN_S}
        self._ended = 0

    def reported(self, at_ns: int, worker: str, job_id: str) -> None:
        """A worker's job took a step."""
        if job_id.startswith("c"):  # clusters; searches are begun anew all the time
            self._reporter[job_id] = worker, at_ns
            self._check_recovered(at_ns, worker, job_id)

    def trackers(self, now_ns: int) -> list[str]:
        """Workers that track a cluster now."""
        recent = now_ns - _REPORTED_LATELY_NS
        return sorted({worker for worker, at_ns in self._reporter.values() if at_ns >= recent})

    def fault(self, fault: DoneFault) -> None:
        """A fault was done; it hits the workers that are its target, or all workers."""
        if fault.kind not in WITHIN_S:
            return
        everybody = fault.kind is Kind.ALL_WORKERS_KILLED
        recent = fault.at_ns - _REPORTED_LATELY_NS
        for job_id, (worker, at_ns) in self._reporter.items():
            hit = everybody or worker in fault.target.split()
            if hit and at_ns >= recent and job_id not in self._orphans:
                self._orphans[job_id] = _Orphan(job_id, worker, fault)

    def believed(self, clusters: Iterable[int]) -> None:
        """A belief was heard: clusters that are not in it any more need nobody to track them."""
        held = {f"c{cluster}" for cluster in clusters}
        for job_id in [job_id for job_id in self._orphans if held and job_id not in held]:
            del self._orphans[job_id]
            self._ended += 1
        for job_id in [job_id for job_id in self._reporter if held and job_id not in held]:
            del self._reporter[job_id]

    def verdicts(self, now_ns: int) -> list[Verdict]:
        """One for each kind of fault."""
        for orphan in list(self._orphans.values()):
            waited_s = (now_ns - orphan.fault.at_ns) / 1e9
            if waited_s > self._allowed_s(orphan.fault, now_ns):
                self._late[orphan.fault.kind].append(_break(orphan, waited_s, "still not back"))
                del self._orphans[orphan.job_id]
        return [self._verdict(kind) for kind in WITHIN_S]

    def _check_recovered(self, at_ns: int, worker: str, job_id: str) -> None:
        orphan = self._orphans.get(job_id)
        if orphan is None:
            return
        fault = orphan.fault
        same_name = worker == orphan.worker
        if same_name and at_ns < fault.until_ns + _IN_FLIGHT_NS:
            return
        del self._orphans[job_id]
        took_s = (at_ns - fault.at_ns) / 1e9
        self._took_s[fault.kind].append(took_s)
        if took_s > self._allowed_s(fault, at_ns):
            self._late[fault.kind].append(_break(orphan, took_s, "back late"))

    def _allowed_s(self, fault: DoneFault, now_ns: int) -> float:
        """Longer where nobody could have been told of it, another fault coming on top."""
        reachable = self._availability.reachable(fault.at_ns, now_ns)
        return WITHIN_S[fault.kind] + (0.0 if reachable else BACK_WITHIN_S)

    def _verdict(self, kind: Kind) -> Verdict:
        took_s, late = self._took_s[kind], self._late[kind]
        longest_s = max(took_s, default=0.0)
        what = {
            Kind.WORKER_KILLED: "a killed worker's clusters go on",
            Kind.WORKER_FROZEN: "a frozen worker's clusters go on",
            Kind.WORKER_LINKS_CUT: "the clusters of workers that are cut off go on",
            Kind.ALL_WORKERS_KILLED: "with all workers killed, their clusters go on",
        }[kind]
        return Verdict(
            promise=what,
            target=f"within {WITHIN_S[kind]:g} s",
            measured=f"{len(took_s)} clusters, longest {longest_s:.2f} s; {len(late)} late",
            kept=None if not took_s and not late else not late,
            breaks=tuple(late[:KEPT_BREAKS]),
            figures={"recovered": len(took_s), "longest_s": longest_s, "late": len(late)},
        )


def _break(orphan: _Orphan, after_s: float, how: str) -> Break:
    what = f"cluster {orphan.job_id} of {orphan.worker}: {how} after {after_s:.1f} s"
    return Break(orphan.fault.at_ns, what)
