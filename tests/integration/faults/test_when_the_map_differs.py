"""docs/failures.md: the map differs between processes: refused, with both digests."""

import os
import signal
import time
from itertools import cycle
from pathlib import Path

import zenoh
from msgspec.structs import replace

from clustermcl.commands.stack import COORDINATOR, WORKERS
from clustermcl.link.wire import Publisher
from clustermcl.protocol import keys
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.steps import Scan
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.recordings.maps.map_message import to_message
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.faults.system import SIMULATOR, SMALL, System, system
from tests.integration.waiting import wait_until
from tests.integration.worlds import world_of
from tests.maps import write_map


def repeat_every_scan(tested: System, ours: str, theirs: str) -> None:
    """Publish each scan of the bridge again, as of bridges that have other maps.

    There are two such maps in turn: a busy machine may deliver three copies in a row, and three
    scans of one other map mean that the bridge has changed its map.
    """
    publisher, others = Publisher(tested.session, keys.SCAN), cycle([theirs, theirs[::-1]])

    def on_scan(sample: zenoh.Sample) -> None:
        scan = decode(sample.payload.to_bytes(), Scan)
        if scan.map_digest == ours:
            publisher.put(replace(scan, map_digest=next(others)))

    tested.session.declare_subscriber(keys.SCAN, on_scan)


def test_scans_and_workers_of_another_map_are_refused_with_both_digests(tmp_path: Path) -> None:
    ours = world_of(SMALL).map.digest
    other = load_map(write_map(world("office").map, tmp_path, "other"))
    theirs = other.digest
    both = f"has map {theirs[:12]}, expected {ours[:12]}"
    with system() as tested, tested.client as client:
        tested.wait_until_it_tracks()
        clusters = tested.clusters()
        started_s = time.monotonic()
        repeat_every_scan(tested, ours, theirs)
        wait_until(lambda: both in tested.log(COORDINATOR))
        wait_until(lambda: client.status().counters["scan of another map"] > 10)
        assert client.status().map_digest == ours
        assert tested.clusters() == clusters, "they change nothing"
        # Another answers for the bridge; the supervisor does not look meanwhile. A worker that
        # starts now is offered the other map, and does not take it.
        tested.hurt(SIMULATOR)

        def answer(query: zenoh.Query) -> None:
            with query:
                query.reply(keys.MAP, encode(to_message(other, "bridge")))

        tested.session.declare_queryable(keys.MAP, answer, complete=True)
        os.kill(tested.worker_pids()[0], signal.SIGKILL)
        wait_until(lambda: both in tested.log(WORKERS))
        wait_until(lambda: client.status().counters.get("order refused", 0) > 0)
        assert client.status().map_digest == ours
        minutes = (time.monotonic() - started_s) / 60.0
        assert tested.log(COORDINATOR).count(both) <= 1 + minutes, "logged once a minute"
