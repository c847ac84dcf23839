import pytest

from protocol import keys
from protocol.errors import MalformedMessageError


def test_every_key_of_a_worker_has_its_name() -> None:
    made = (
        *(keys.worker_alive("w-0"), keys.worker_order("w-0"), keys.worker_state("w-0")),
        *(keys.worker_advice("w-0"), keys.worker_report("w-0"), keys.worker_health("w-0")),
    )
    assert len(set(made)) == len(made)
    assert {keys.worker_name(key) for key in made} == {"w-0"}


@pytest.mark.parametrize(
    "key",
    [
        *("", "worker", "worker/w-0", "worker/a/b/report"),
        *("other/w-0/report", "scan/", "bridge/health", keys.SCAN),
    ],
)
def test_only_a_workers_key_has_a_workers_name(key: str) -> None:
    with pytest.raises(MalformedMessageError, match="worker's key"):
        keys.worker_name(key)
