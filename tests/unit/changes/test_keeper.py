import zlib
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from clustermcl.changes.collector import RECORD, ChangeCollector
from clustermcl.changes.keeper import ChangeKeeper
from clustermcl.changes.new_map import OtherMapError, joined
from clustermcl.link.node import Node
from clustermcl.protocol.changes import GONE, KeptChanges
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.conversion import with_checksum
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.steps import Landmark
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.stop import StopFlag
from clustermcl.sensor_bridge.building_changes import BuildingChanges
from tests.unit.changes.drives import OLD, TRUE, Drive, scan_at
from tests.unit.evaluation.places import belief, place

DRIVEN = Drive().steps(60)
KEPT = DRIVEN.collector.kept


def keeper(folder: Path) -> ChangeKeeper:
    return ChangeKeeper(OLD, folder, "r 1", "bridge")


def test_changes_survive_a_restart(tmp_path: Path) -> None:
    first = keeper(tmp_path)
    first._collector = DRIVEN.collector
    assert first.renew()
    assert not first.renew()
    first.save()
    tagged = OLD.with_landmarks([Landmark(name="tag", x=1.0, y=1.0, sigma=0.05)])
    again = ChangeKeeper(tagged, tmp_path, "r 1", "bridge")
    assert again.newest.map_digest == tagged.digest
    assert again.newest.cells == first.newest.cells
    assert again.newest.times_s == first.newest.times_s
    assert [file.name for file in tmp_path.iterdir()] == ["changes-r%201.msgpack"]
    assert next(tmp_path.iterdir()).stat().st_mode & 0o077 == 0
    assert len(ChangeKeeper(TRUE, tmp_path, "r 1", "bridge").newest.cells.array()) == 0


def test_two_threads_do_not_write_the_file_at_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    kept = keeper(tmp_path)
    with ThreadPoolExecutor(8) as pool:
        for _ in range(50):
            pool.submit(kept.save)
    assert caplog.text == ""


def test_a_robot_that_is_found_elsewhere_after_a_restart_loses_what_is_not_trusted() -> None:
    collector = ChangeCollector(OLD)
    collector.restore(KEPT)
    assert len(collector.changes("test").cells.array())
    collector.withdraw()
    assert len(collector.changes("test").cells.array()) == 0
    assert collector.changes("test").seen_share == 0.0


def records(**changed: object) -> bytes:
    made = np.zeros(2, RECORD)
    made["cell"] = 1, 2
    for name, value in changed.items():
        made[name] = value
    return made.tobytes()


HOSTILE = {
    "a part of a record": {"records": b"x" * 7},
    "no order": {"records": records(cell=(2, 1))},
    "twice": {"trusted": records(cell=(1, 1))},
    "outside": {"records": records(cell=(1, 10**9))},
    "below": {"records": records(cell=(-1, 1))},
    "never": {"records": records(since_s=np.nan)},
    "endless evidence": {"records": records(evidence=np.inf)},
    "nowhere": {"records": records(x_m=np.inf)},
    "many changes": {"records": records(changes=2**31 - 1)},
    "no such state": {"records": records(occupied=2)},
    "a bomb": {"zlib_seen_min": zlib.compress(bytes(10**8))},
    "no times": {"zlib_seen_min": b""},
}


@pytest.mark.parametrize("bad", HOSTILE.values(), ids=HOSTILE)
def test_a_damaged_file_is_not_used(
    tmp_path: Path, bad: dict[str, bytes], caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "changes-r%201.msgpack"
    file.write_bytes(with_checksum(encode(replace(KEPT, **bad))))
    assert len(keeper(tmp_path).newest.cells.array()) == 0
    assert "are not used" in caplog.text


@given(data=st.binary(max_size=200), at=st.integers(0, 500))
def test_any_bytes_are_taken_or_refused(data: bytes, at: int) -> None:
    whole = bytearray(msgspec.msgpack.encode(KEPT))
    whole[at : at + len(data)] = data
    collector = ChangeCollector(OLD)
    with suppress(ValueError, MalformedMessageError):
        collector.restore(decode(bytes(whole), KeptChanges))
    collector.changes("test")


def test_records_of_another_version_are_not_used() -> None:
    collector = ChangeCollector(OLD)
    collector.restore(replace(KEPT, layout="older"))
    assert not len(collector.records)


def test_of_several_robots_the_newest_sighting_counts() -> None:
    seen = DRIVEN.collector.changes("a")
    later = Drive()
    later.step = 600  # ten minutes
    as_mapped = later.steps(60, OLD).collector.changes("b")
    assert not len(as_mapped.cells.array())
    assert DRIVEN.kinds()[GONE] == 20
    only_first = joined([seen, Drive().collector.changes("c")])
    assert only_first.cells == seen.cells
    both = joined([seen, as_mapped])
    kinds = both.cells.array()[:, 1]
    assert len(kinds) <= 10  # the side of the shelf that the other robot cannot see
    assert (kinds == GONE).all()
    assert joined([as_mapped, seen]).cells == both.cells
    with pytest.raises(OtherMapError):
        joined([seen, replace(seen, map_digest="other")])


def test_a_standing_robot_collects_nothing_new_of_a_belief_without_places(tmp_path: Path) -> None:
    keeping = keeper(tmp_path)
    scan = scan_at(TRUE, (1.0, 0.4, 0.0), 0, OLD.digest)
    keeping.on_step(scan, belief(0, "searching"))
    keeping.on_step(scan, belief(0, "localized", place(1.0, (1.0, 0.4, 0.0))))
    assert not keeping.renew()
    assert keeping.newest.seen_share > 0.3


def test_a_bridge_without_kernels_runs_on_and_collects_nothing(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("clustermcl.filter.kernels.library.library", lambda: None)
    monkeypatch.setattr("clustermcl.jobs.warm_up.find_spec", lambda _module: None)
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    node = Node("bridge", "bridge", Settings(), StopFlag(), peers=None)
    BuildingChanges(node, None).begin(OLD)
    assert node.turn(10.0) is not None, "the result of the background"
    assert "not collected: there are no compiled kernels" in caplog.text
