"""What each role may do at a router with access control, each case tried for real.

Zenoh drops in silence what is denied. To avoid waiting for messages that never arrive, the
permitted role publishes last: links keep their order, so every admitted message arrives before it.
"""

import itertools
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh
from zenoh import handlers

from clustermcl.link.access_control import WORKER_PROCESSES, rights_of
from clustermcl.protocol import keys
from tests.integration.security.certificates import require_openssl
from tests.integration.security.conftest import NAMES, OpenAs
from tests.integration.waiting import PATIENCE_S, wait_until

require_openssl()

REPORT_A = keys.worker_report("worker-a-0")
RIGHTS = {
    name: rights_of("worker", f"{name}-0") if name.startswith("worker-") else rights_of(name)
    for name in NAMES
}


def holders(right: str, key: str) -> list[str]:
    """The certificates that have a right to a key; docs/security.md has the same table."""
    wanted = zenoh.KeyExpr(key)
    return [
        name
        for name, rights in RIGHTS.items()
        if any(zenoh.KeyExpr(held).includes(wanted) for held in getattr(rights, right))
    ]


def owned(right: str) -> list[str]:
    """The keys that some certificate alone may write, but those of the second worker."""
    found = {key for rights in RIGHTS.values() for key in getattr(rights, right)}
    return sorted(key for key in found if "worker-b" not in key)


_ROUNDS = itertools.count()


def pattern(key: str) -> str:
    """As the coordinator subscribes: to all workers at once."""
    return "/".join("*" if part.startswith("worker-") else part for part in key.split("/"))


def received_by(reader: zenoh.Session, key: str, speakers: list[zenoh.Session]) -> set[str]:
    """The roles whose messages arrive on a key; the last one must be permitted."""
    turn, received = next(_ROUNDS), set()
    subscriber = reader.declare_subscriber(pattern(key), handlers.FifoChannel(100))
    try:
        for speaker in speakers[:-1]:
            speaker.put(key, f"{turn} {speaker.zid()}")
            list(
                speaker.get("nothing", timeout=PATIENCE_S)
            )  # once answered, the router has seen the put

        def last_is_received() -> bool:
            speakers[-1].put(key, f"{turn} {speakers[-1].zid()}")
            for sample in iter(subscriber.try_recv, None):
                words = sample.payload.to_string().split()
                received.update(words[1:] if words[0] == str(turn) else [])
            return str(speakers[-1].zid()) in received

        wait_until(last_is_received)  # the subscription takes a moment to reach the speaker
    finally:
        subscriber.undeclare()
    return received


@contextmanager
def serving(session: zenoh.Session, key: str) -> Iterator[None]:
    """Answer queries on the key with the server's own id."""

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(key, str(session.zid()))

    queryable = session.declare_queryable(key, answer, complete=True)
    try:
        yield
    finally:
        queryable.undeclare()


def answers(session: zenoh.Session, key: str) -> set[str]:
    every_queryable, each_answer = zenoh.QueryTarget.ALL, zenoh.ConsolidationMode.NONE
    replies = session.get(
        key, timeout=PATIENCE_S, target=every_queryable, consolidation=each_answer
    )
    return {reply.ok.payload.to_string() for reply in replies if reply.ok is not None}


@pytest.mark.parametrize("key", owned("publishes"))
def test_only_a_keys_owners_can_publish_on_it(key: str, as_role: OpenAs) -> None:
    owners = holders("publishes", key)
    reader = next(name for name in holders("reads", key) if name not in owners)
    others = [name for name in NAMES if name not in (*owners, reader)]
    speakers = [as_role(name) for name in (*others, owners[0])]
    assert received_by(as_role(reader), key, speakers) == {str(as_role(owners[0]).zid())}


@pytest.mark.parametrize("key", owned("serves"))
def test_only_permitted_roles_are_answered_and_only_a_keys_owner_answers(
    key: str, as_role: OpenAs
) -> None:
    (owner,) = holders("serves", key)
    entitled = set(holders("asks", key)) - {owner}
    with serving(as_role(owner), key):
        wait_until(lambda: answers(as_role(min(entitled)), key))
        for impostor in set(NAMES) - {owner}:
            for asker in sorted(entitled - {impostor})[:1]:
                with serving(as_role(impostor), key):
                    list(as_role(impostor).get("nothing", timeout=PATIENCE_S))
                    assert answers(as_role(asker), key) == {str(as_role(owner).zid())}
        served = {name for name in NAMES if name != owner and answers(as_role(name), key)}
    assert served == entitled


@pytest.mark.parametrize("key", owned("announces"))
def test_only_the_owner_of_a_liveliness_token_can_declare_it(key: str, as_role: OpenAs) -> None:
    (owner,) = holders("announces", key)
    watcher = next((name for name in holders("watches", key) if name != owner), owner)

    def alive() -> bool:
        replies = as_role(watcher).liveliness().get(pattern(key), timeout=PATIENCE_S)
        return any(reply.ok is not None and str(reply.ok.key_expr) == key for reply in replies)

    for impostor in set(NAMES) - {owner, watcher}:
        with as_role(impostor).liveliness().declare_token(key):
            list(as_role(impostor).get("nothing", timeout=PATIENCE_S))
            assert not alive()
    with as_role(owner).liveliness().declare_token(key):
        wait_until(alive)


def test_a_workers_certificate_announces_a_bounded_number_of_names(as_role: OpenAs) -> None:
    coordinator, worker = as_role("coordinator"), as_role("worker-a")
    names = [f"worker-a-{number}" for number in range(2 * WORKER_PROCESSES)]
    names += ["worker-a-x-0", "worker-a-00"]
    tokens = [worker.liveliness().declare_token(keys.worker_alive(name)) for name in names]

    def alive() -> set[str]:
        replies = coordinator.liveliness().get(keys.ALL_WORKERS_ALIVE, timeout=PATIENCE_S)
        return {keys.worker_name(str(reply.ok.key_expr)) for reply in replies if reply.ok}

    allowed = set(names[:WORKER_PROCESSES])
    wait_until(lambda: allowed <= alive())
    list(worker.get("nothing", timeout=PATIENCE_S))
    assert alive() == allowed
    for token in tokens:
        token.undeclare()
    wait_until(lambda: not alive())


def test_a_viewer_sees_no_reports_however_it_asks(as_role: OpenAs) -> None:
    viewer, coordinator = as_role("viewer"), as_role("coordinator")
    greedy = [viewer.declare_subscriber(key, handlers.FifoChannel(9)) for key in ("**", REPORT_A)]
    list(viewer.get("nothing", timeout=PATIENCE_S))
    assert received_by(coordinator, REPORT_A, [as_role("worker-a")])
    list(viewer.get("nothing", timeout=PATIENCE_S))
    assert [subscriber.try_recv() for subscriber in greedy] == [None, None]
    for subscriber in greedy:
        subscriber.undeclare()


def test_no_role_reads_the_routers_own_pages(as_role: OpenAs) -> None:
    operator = as_role("operator")
    (router,) = operator.info.routers_zid()
    assert list(operator.get(f"@/{router}/**", timeout=PATIENCE_S)) == []


def test_a_driver_connects_with_the_commands_of_the_page(
    certificates: Path, secure_endpoint: str, as_role: OpenAs
) -> None:
    page = (Path(__file__).parents[3] / "docs" / "security.md").read_text()
    lines = page.split("<!-- driver -->\n```python\n")[1].split("```")[0]
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("namespace", '"robot"')
    config.insert_json5("connect/endpoints", json.dumps([secure_endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    code = lines.replace("/etc/clustermcl/certificates", str(certificates))
    exec(code, {"config": config, "json": json})  # our own page
    with zenoh.open(config) as driver:
        assert received_by(as_role("bridge"), keys.LASER_READING, [driver])
