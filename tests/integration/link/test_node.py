import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import partial

import pytest
import zenoh
from msgspec.structs import replace

from clustermcl.link.node import Node
from clustermcl.link.wire import Asked, Link, Token, is_alive
from clustermcl.protocol import keys
from clustermcl.protocol.answers import CommandDone, Update
from clustermcl.protocol.codec import decode
from clustermcl.protocol.errors import RefusedError
from clustermcl.protocol.steps import OdometryReading
from clustermcl.runtime.settings import Settings, ZenohSettings
from clustermcl.runtime.stop import StopFlag
from tests.integration.conftest import OpenClient
from tests.integration.waiting import PATIENCE_S, answered, wait_until

ORIGIN = (0.0, 0.0, 0.0)
DONE = CommandDone(sender="another")


@contextmanager
def opened(router: ZenohSettings, name: str) -> Iterator[Node]:
    settings = replace(Settings(), zenoh=router)
    with closing(Node(name, "bridge", settings, StopFlag(), peers=None)) as made:
        made.open(PATIENCE_S)
        yield made


@pytest.fixture
def node(router: ZenohSettings) -> Iterator[Node]:
    with opened(router, "tested") as made:
        yield made


@pytest.fixture
def other(router: ZenohSettings) -> Iterator[Node]:
    with opened(router, "another") as made:
        yield made


def turning(*nodes: Node) -> bool:
    for node in nodes:
        node.turn(0.01)
    return True


def test_a_query_is_repeated_until_a_process_answers(node: Node, other: Node) -> None:
    answers, failures = list[CommandDone](), list[str]()
    node.ask(
        keys.UPDATE,
        CommandDone,
        answers.append,
        failures.append,
        timeout_s=1.0,
        repeat_for_s=PATIENCE_S,
    )
    for _ in range(100):  # a second, in which no process serves the key
        turning(node)
    assert (answers, failures) == ([], [])
    other.serve(keys.UPDATE, lambda asked: asked.answer(DONE))
    wait_until(lambda: turning(node, other) and answers)
    assert (answers, failures) == ([DONE], [])


def test_a_query_on_many_keys_is_answered_on_each(node: Node, other: Node) -> None:
    served, replies = {keys.UPDATE, keys.worker_state("w")}, list[zenoh.Reply]()
    for key in served:
        node.serve(key, lambda asked: asked.answer(DONE))

    def all_answer() -> bool:
        other.session.get("**", replies.append)
        return turning(node) and {str(one.ok.key_expr) for one in replies if one.ok} == served

    wait_until(all_answer)


def test_a_token_is_not_lost_while_queries_fill_the_inbox(node: Node, other: Node) -> None:
    changes = list[Token]()
    node.watch(keys.BRIDGE_ALIVE, changes.append)
    while node.inbox.put("a query"):
        pass
    other.announce(keys.BRIDGE_ALIVE)
    wait_until(lambda: is_alive(node.session, keys.BRIDGE_ALIVE, 1.0))
    wait_until(lambda: (turning(*[node] * 100) and changes) or node.inbox.dropped()["event"] > 1)
    assert set(changes) == {Token(keys.BRIDGE_ALIVE, alive=True)}


def test_a_session_stays_suspect_when_a_query_times_out_after_its_link_returned(
    node: Node, other: Node
) -> None:
    """Zenoh reports the time-out of a query as an error reply, though nothing was received."""
    asked, failures = list[Asked](), list[str]()
    other.serve(keys.UPDATE, asked.append)
    other.announce(keys.COORDINATOR_ALIVE)
    node.peers = keys.COORDINATOR_ALIVE
    for up in (False, True):
        node.inbox.put_own(Link(up=up))
    while not asked:  # until the router knows the queryable
        node.ask(keys.UPDATE, CommandDone, lambda _: None, failures.append, timeout_s=0.5)
        wait_until(lambda: turning(node, other) and (asked or failures))
    failures.clear()
    wait_until(lambda: turning(node, other) and failures)
    assert node.replace_stale_session()


def test_messages_of_a_process_arrive_in_their_order_and_no_key_costs_a_thread(
    node: Node, other: Node
) -> None:
    threads, seen = threading.active_count(), list[int]()
    kinds = [str(number) for number in range(20)]
    for kind in kinds:
        take = lambda reading, _: seen.append(reading.stamp_ns)  # noqa: E731
        node.subscribe(f"key/{kind}", OdometryReading, take, kind=kind, kept=100)
    assert threading.active_count() == threads
    publishers = [other.publisher(f"key/{kind}", may_wait=True) for kind in kinds]

    def publish(stamp_ns: int) -> None:
        odometry = OdometryReading(sender="another", stamp_ns=stamp_ns, odom_from_robot=ORIGIN)
        publishers[stamp_ns % len(publishers)].put(odometry)

    def are_heard(numbers: range) -> bool:
        while node.turn(0.01):
            pass
        return set(numbers) <= set(seen)

    def all_are_heard() -> bool:
        for number in range(len(kinds)):
            publish(number)
        return are_heard(range(len(kinds)))

    wait_until(all_are_heard)
    for first in range(1000, 2000, 10):  # a link that cannot pass on 16 for 0.3 s is closed
        burst = range(first, first + 10)
        for number in burst:
            publish(number)
        wait_until(partial(are_heard, burst))
    assert seen[seen.index(1000) :] == list(range(1000, 2000))


def test_a_malformed_query_is_refused_and_counted(node: Node, open_client: OpenClient) -> None:
    def on_update(asked: Asked) -> None:
        decode(asked.payload, Update)
        asked.answer(DONE)

    node.serve(keys.UPDATE, on_update)
    problems = list[str]()

    def refused() -> None:
        try:
            answered(client, keys.UPDATE, CommandDone)
        except RefusedError as error:
            problems.append(str(error))

    client = open_client()
    node.in_background(refused, lambda _done: None)
    wait_until(lambda: turning(node) and problems)
    assert "Update" in problems[0] or "update" in problems[0]
    assert len(node.health.dropped()) == 1


def test_a_new_session_declares_everything_and_reports_no_lost_link(
    node: Node, open_client: OpenClient
) -> None:
    links = list[bool]()
    node.watch_link(lambda link: links.append(link.up))
    node.serve(keys.UPDATE, lambda asked: asked.answer(DONE))
    node.announce(keys.BRIDGE_ALIVE)
    wait_until(lambda: turning(node) and links)
    node.open(PATIENCE_S)
    client, answers = open_client(), list[CommandDone]()
    wait_until(lambda: turning(node) and is_alive(client, keys.BRIDGE_ALIVE, 5.0))
    node.in_background(
        lambda: answers.append(answered(client, keys.UPDATE, CommandDone)), lambda _done: None
    )
    wait_until(lambda: turning(node) and answers)
    assert False not in links
