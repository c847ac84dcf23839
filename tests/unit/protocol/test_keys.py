import pytest

from protocol import keys
from protocol.errors import MalformedMessageError
from protocol.keys import WorkerKey, WorkerTopic
from protocol.limits import max_bytes_on
from protocol.message import LARGEST_BYTES, SMALL_BYTES

CONSTANTS = [
    value
    for name, value in vars(keys).items()
    if name.isupper() and isinstance(value, str) and "*" not in value
]


@pytest.mark.parametrize("key", CONSTANTS)
def test_every_constant_is_parsed_as_itself(key: str) -> None:
    assert keys.parsed(key) == key


def test_every_key_of_a_worker_is_parsed_as_its_name_and_topic() -> None:
    made = {
        keys.worker_alive("w-0"): WorkerTopic.ALIVE,
        keys.worker_order("w-0"): WorkerTopic.ORDER,
        keys.worker_state("w-0"): WorkerTopic.STATE,
        keys.worker_advice("w-0"): WorkerTopic.ADVICE,
        keys.worker_report("w-0"): WorkerTopic.REPORT,
        keys.worker_health("w-0"): WorkerTopic.HEALTH,
    }
    assert set(made.values()) == set(WorkerTopic)
    for key, topic in made.items():
        assert keys.parsed(key) == WorkerKey("w-0", topic)
        assert keys.worker_name(key) == "w-0"


@pytest.mark.parametrize(
    "key",
    [
        *("", "worker", "worker/w-0", "worker/w-0/gossip", "worker/a/b/report"),
        *("other/w-0/report", "scan/", "bridge/report"),
    ],
)
def test_an_unknown_key_is_refused(key: str) -> None:
    with pytest.raises(MalformedMessageError, match="not a valid key"):
        keys.parsed(key)


def test_only_a_workers_key_has_a_workers_name() -> None:
    with pytest.raises(MalformedMessageError, match="worker's key"):
        keys.worker_name(keys.SCAN)


def test_only_orders_and_reports_of_workers_may_be_large() -> None:
    large = {keys.worker_order("w-0"), keys.worker_report("w-0")}
    for topic in WorkerTopic:
        key = f"worker/w-0/{topic}"
        assert max_bytes_on(key) == (LARGEST_BYTES if key in large else SMALL_BYTES)
    assert max_bytes_on("of/an/extension") == SMALL_BYTES
