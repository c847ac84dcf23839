from contextlib import ExitStack, suppress

import zenoh

from clustermcl.client import Client
from process_runtime.settings import Settings
from process_runtime.stop import StopFlag
from protocol import keys
from protocol.answers import Status
from protocol.codec import decode
from protocol.errors import MalformedMessageError
from protocol.steps import Scan
from tests.integration.system.conftest import SMALL, StartStack
from tests.integration.system.listening import beliefs_of, outcomes_of
from tests.integration.system.rubbish import ANOTHER_MAP, ForeignSender
from tests.integration.waiting import PATIENCE_S, patient_client, wait_until
from zenoh_link.session import open_session

STEPS = 30
SPEAKS_FROM, SHOUTS_AT, SPEAKS_TO = 3, 13, STEPS - 4
MAX_MEMORY_BYTES = 350_000_000
"""The largest process has 200 MB in quiet; four messages of 100 and 33 MB are shouted."""


def dropped_by(status: Status, role: str) -> dict[str, int]:
    found: dict[str, int] = {}
    for process in status.processes:
        if process.role == role:
            for cause, times in process.dropped.items():
                found[cause] = found.get(cause, 0) + times
    return found


class Disturbance:
    """An intruder from the first step on."""

    def __init__(self, settings: Settings, resources: ExitStack) -> None:
        self._settings, self._resources = settings, resources
        self._scans: dict[int, Scan] = {}
        self._foreign: ForeignSender | None = None

    def arrive(self) -> None:
        session = self._resources.enter_context(
            open_session(self._settings.zenoh, self._settings.robot, StopFlag(), wait_s=PATIENCE_S)
        )
        session.declare_subscriber(keys.SCAN, self._on_scan)
        self._foreign = ForeignSender(session, self._scans)

    def disturb(self) -> None:
        if self._foreign and self._scans:
            self._foreign.speak()
            self._foreign.ask()

    def shout(self) -> None:
        if self._foreign:
            self._foreign.shout()

    def _on_scan(self, sample: zenoh.Sample) -> None:
        with suppress(MalformedMessageError):
            scan = decode(sample.payload.to_bytes(), Scan)
            if scan.map_digest != ANOTHER_MAP:
                self._scans.setdefault(scan.step, scan)


def test_malformed_messages_on_every_key_are_counted_by_cause_and_change_no_belief(
    start_stack: StartStack,
) -> None:
    stack, settings = start_stack(SMALL, steps=STEPS)
    with ExitStack() as resources:
        foreign = Disturbance(settings, resources)
        at_step = dict.fromkeys(range(SPEAKS_FROM, SPEAKS_TO, 4), foreign.disturb) | {
            0: foreign.arrive,
            SHOUTS_AT: foreign.shout,
        }
        received = beliefs_of(stack, settings, at_step=at_step, among_foreign=True)
        with Client(patient_client(settings)) as client:
            wait_until(lambda: not uncounted(client.status()))
            processes = client.status().processes
    beliefs = {
        belief.step: belief for belief in received
    }  # a repeated query gets a repeated answer
    assert list(beliefs) == list(range(STEPS))
    for step, outcome in enumerate(outcomes_of(SMALL, steps=STEPS)):
        assert beliefs[step].missing == (), f"step {step}"
        assert beliefs[step].hypotheses == outcome.hypotheses, f"step {step}"
        assert beliefs[step].state == outcome.state, f"step {step}"
    for process in processes:
        assert process.memory_bytes < MAX_MEMORY_BYTES, process.sender


REPORT = "TrackReport or SearchReport or ElsewhereReport or ReportBatch"
EXPECTED = {
    "coordinator": {
        "scan of another map", "scan repeated or late", "report of an old epoch",
        "dropped scan too large", "dropped query too large", "malformed worker name: impossible",
        *(f"malformed {message}: {kind}"
          for message in ("Scan", REPORT, "SetPose", "Relocalize", "Health")
          for kind in ("not MessagePack", "schema", "field")),
        f"malformed {REPORT}: impossible", "malformed SetPose: impossible",
    },
    "worker": {
        "malformed Scan: schema", "malformed Scan: impossible", "scan of another map",
        "malformed WorkOrder: impossible", "malformed TakeOver: not MessagePack",
        "order of an old term",
    },
    "bridge": {"malformed Kidnap: field", "malformed question for scans"},
}  # fmt: skip
"""The causes that the intruder produces, by the role of the process that must have counted them."""


def uncounted(status: Status) -> dict[str, set[str]]:
    """Expected causes that no process of the role has counted."""
    missing = {role: causes - dropped_by(status, role).keys() for role, causes in EXPECTED.items()}
    return {role: causes for role, causes in missing.items() if causes}
