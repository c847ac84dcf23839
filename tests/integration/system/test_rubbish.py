from collections import Counter

from clustermcl.protocol.answers import Status
from tests.integration.alone import assert_same, outcomes_of
from tests.integration.faults.system import system
from tests.integration.system.conftest import SMALL
from tests.integration.system.rubbish import ForeignSender
from tests.integration.waiting import wait_until

STEPS = 30
SPEAKS_FROM, SHOUTS_AT, SPEAKS_TO = 3, 13, STEPS - 4
MAX_MEMORY_BYTES = 350_000_000
"""The largest process has 200 MB in quiet; four messages of 100 and 33 MB are shouted."""


def dropped_by(status: Status, role: str) -> dict[str, int]:
    found = Counter[str]()
    for process in status.processes:
        if process.role == role:
            found.update(process.dropped)
    return found


def test_malformed_messages_on_every_key_are_counted_by_cause_and_change_no_belief() -> None:
    with system(SMALL, "--steps", str(STEPS)) as tested, tested.client as client:
        foreign = ForeignSender(tested.session)
        for step in sorted({*range(SPEAKS_FROM, SPEAKS_TO, 4), SHOUTS_AT}):
            wait_until(lambda s=step: tested.step >= s and foreign.scans)  # type: ignore[misc] # a default
            if step == SHOUTS_AT:
                foreign.shout()
            else:
                foreign.speak()
                foreign.ask()
        received = tested.wait_for_the_end()
        wait_until(lambda: not uncounted(client.status()))
        processes = client.status().processes
        tested.stack.check()
    assert sorted({belief.step for belief in received}) == list(range(STEPS))
    assert_same(received, outcomes_of(SMALL, steps=STEPS))
    for process in processes:
        assert process.memory_bytes < MAX_MEMORY_BYTES, process.sender


REPORT = "TrackReport or SearchReport or ElsewhereReport or ReportBatch"
EXPECTED = {
    "coordinator": {
        "scan of another map", "scan repeated or late", "report of an old epoch",
        "dropped scan too large", "dropped query too large", "malformed worker name: impossible",
        *(f"malformed {message}: {kind}"
          for message in ("Scan", REPORT, "SetPose", "Relocalize", "Health")
          for kind in ("not MessagePack", "schema")),
        "malformed Scan: field", f"malformed {REPORT}: impossible",
    },
    "worker": {
        "malformed Scan: schema", "scan of another map", "malformed TakeOver: not MessagePack",
    },
    "bridge": {"malformed question for scans"},
}  # fmt: skip
"""The causes that the intruder produces, by the role of the process that must have counted them."""


def uncounted(status: Status) -> dict[str, set[str]]:
    missing = {role: causes - dropped_by(status, role).keys() for role, causes in EXPECTED.items()}
    return {role: causes for role, causes in missing.items() if causes}
