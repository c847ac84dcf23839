import json
import zlib
from contextlib import nullcontext
from pathlib import Path

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from clustermcl.changes.new_map import OtherMapError, with_changes
from clustermcl.commands.command import app
from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.changes import MOVED, Changes
from clustermcl.protocol.codec import decode
from clustermcl.protocol.errors import ClusterMclError, MalformedMessageError
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.recordings.maps.ros_map import save_ros_map
from clustermcl.runtime.settings import Settings
from tests.unit.changes.drives import CHAIR, OLD, PILLARS, SHELF, TRUE, Drive, path, room, scan_at


@pytest.fixture(scope="module")
def changes() -> Changes:
    return Drive().steps(60).collector.changes("test")


def test_the_new_map_has_what_has_changed(changes: Changes) -> None:
    cells = with_changes(OLD, changes).cells
    assert (cells[SHELF] == FREE).all()
    assert np.count_nonzero(cells[CHAIR] == OCCUPIED) >= 12
    differs = cells != TRUE.cells
    assert np.count_nonzero(differs) <= 40  # 0.1 m² of the chair's sides


def test_a_moving_cell_is_free_in_the_new_map(changes: Changes) -> None:
    cells = changes.cells.array().copy()
    cells[:, 1] = MOVED
    moved = replace(changes, cells=ArrayBlob.of(cells, "int32"))
    assert not (with_changes(OLD, moved).cells[CHAIR] == OCCUPIED).any()


def test_what_no_beam_has_reached_behind_a_wall_that_is_gone_is_unknown(changes: Changes) -> None:
    unseen = replace(changes, zlib_seen_min=b"")
    front = unseen.chosen(np.arange(len(unseen.cells.array())) < 10)  # one row of the shelf
    cells = with_changes(OLD, front).cells
    assert (cells[20:22, 60:80] == FREE).all()
    assert (cells[22:24, 60:80] == UNKNOWN).all()
    assert (cells[0] == OLD.cells[0]).all()


def test_changes_of_another_map_are_refused(changes: Changes) -> None:
    with pytest.raises(OtherMapError, match="do not belong to map"):
        with_changes(TRUE, changes)
    for forged in ({"cell_m": 1e-9}, {"cell_m": 0.2}, {"rows": changes.rows + 1}):
        with pytest.raises(OtherMapError):
            with_changes(OLD, replace(changes, **forged))


def test_only_what_was_seen_lately_is_kept(changes: Changes) -> None:
    seen_s = changes.times_s.array()[:, 1]
    lately = changes.seen_within(10.0)
    assert len(lately.cells.array()) == np.count_nonzero(seen_s >= 49.0) > 0


HOSTILE = {
    "no rows": {"rows": 0},
    "too large": {"rows": 2**20, "cols": 2**20},
    "too small": {"cols": 3},
    "in no order": {"cells": ArrayBlob.of([[9, 0, 1, 1], [8, 0, 1, 1]], "int32")},
    "outside": {"cells": ArrayBlob.of([[-1, 0, 1, 1], [8, 0, 1, 1]], "int32")},
    "of a kind": {"cells": ArrayBlob.of([[1, 3, 1, 1], [8, 0, 1, 1]], "int32")},
    "of a type": {"cells": ArrayBlob.of(np.zeros((2, 4)), "float64")},
    "of a length": {"cells": ArrayBlob.of(np.zeros((3, 4)), "int32")},
    "of no size": {"cells": ArrayBlob(dtype="int32", shape=(2, 4), data=b"x")},
    "never": {"times_s": ArrayBlob.of(np.full((2, 2), np.nan), "float64")},
    "of float": {"times_s": ArrayBlob.of(np.zeros((2, 2)), "float32")},
}


@pytest.mark.parametrize("bad", HOSTILE.values(), ids=HOSTILE)
def test_a_hostile_message_is_refused(changes: Changes, bad: dict[str, object]) -> None:
    first = changes.chosen(np.arange(len(changes.cells.array())) < 2)
    plain = msgspec.structs.asdict(first) | {"schema": "changes/1"}
    assert decode(msgspec.msgpack.encode(plain), Changes) == first
    with pytest.raises(MalformedMessageError):
        decode(msgspec.msgpack.encode(plain | bad), Changes)


@pytest.mark.parametrize("data", [b"x", b"x" * 100])
def test_times_that_do_not_fill_the_grid_are_refused(changes: Changes, data: bytes) -> None:
    for bad in (data, zlib.compress(bytes(10**8)), changes.zlib_seen_min[:-9]):
        with pytest.raises(MalformedMessageError):
            replace(changes, zlib_seen_min=bad).seen_min()


def test_the_command_writes_the_new_map_of_a_recording(tmp_path: Path) -> None:
    mapped, true = room(SHELF, *PILLARS), room(CHAIR, *PILLARS)
    old, log = tmp_path / "old.yaml", tmp_path / "robot.log"
    save_ros_map(mapped, old)
    lines = []
    for step, pose in enumerate(path(0, 80)):
        ranges = scan_at(true, pose, step, "").ranges.array()
        at, beams = " ".join(map(str, pose)), " ".join(f"{each:.3f}" for each in ranges)
        laser = f"ROBOTLASER1 0 {-np.pi} {2 * np.pi} {np.pi / 180} 12.0 0.01 0 360"
        lines.append(f"{laser} {beams} 0 {at} {at} 0 0 0 0 0 {step}.0 test {step}.0")
    log.write_text("\n".join(lines))
    command = ["changes", "--recording", str(log), "--map", str(old), "--json"]
    result = CliRunner().invoke(app, [*command, "--output", str(tmp_path / "new.yaml")])
    assert result.exit_code == 0, result.output
    assert 0.1 < json.loads(result.stdout)["gone_m2"] < 0.4
    new = load_map(tmp_path / "new.yaml")
    assert (
        np.count_nonzero(new.cells != true.cells) < np.count_nonzero(mapped.cells != true.cells) / 2
    )
    assert load_map(tmp_path / "new.old.yaml").digest == load_map(old).digest
    assert (tmp_path / "new.changes.png").stat().st_size > 1000
    wrong = [f"--since {10**400}d", "--router tcp/r:1", "--recording nowhere.log"]
    (tmp_path / "image-of-another.png").touch()
    wrong += [f"--output {tmp_path / name}.yaml" for name in ("image-of-another", "new.old")]
    for words in (*wrong, "--since 7x", "--output new.png", f"--output {old.parent}/./old.yaml"):
        refused = CliRunner().invoke(app, [*command, *words.split()])
        assert isinstance(refused.exception, ClusterMclError), words


@pytest.mark.parametrize(
    ("words", "variables"),
    [(["--robot", "r1", "--robot", "r2"], {}), ([], {"CLUSTERMCL_ROBOT": "r1 r2"})],
)
def test_the_command_asks_each_robot(
    words: list[str], variables: dict[str, str], monkeypatch: pytest.MonkeyPatch, changes: Changes
) -> None:
    asked: list[str] = []

    class Robot:
        def __init__(self, settings: Settings) -> None:
            asked.append(settings.robot.name)

        def changes(self) -> Changes:
            return changes

        def map(self) -> GridMap:
            return OLD

    monkeypatch.setattr(
        "clustermcl.commands.options.connected", lambda settings: nullcontext(Robot(settings))
    )
    result = CliRunner().invoke(app, ["changes", *words, "--since", "1d"], env=variables)
    assert result.exit_code == 0, result.output
    assert asked == ["r1", "r2"]
    assert result.output.startswith("gone 0.20 m2")
