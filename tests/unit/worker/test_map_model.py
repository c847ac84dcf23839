import errno
import logging
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from clustermcl.filter.laser.sensor_model import MapArrays
from clustermcl.filter.settings import SensorSettings
from clustermcl.jobs import map_model
from clustermcl.jobs.map_model import sensor_model
from clustermcl.protocol.steps import Landmark
from clustermcl.recordings.maps.grid_map import GridMap

SETTINGS = SensorSettings()


def grid_map(*, box: bool = True) -> GridMap:
    cells = np.zeros((30, 40), np.int8)
    cells[[0, -1], :] = 1
    if box:
        cells[10:14, 20:25] = 1
    return GridMap(cells, 0.1, (1.0, 2.0, 0.3))


def test_a_model_from_the_cache_is_the_computed_one(tmp_path: Path) -> None:
    computed = sensor_model(grid_map(), SETTINGS, None)
    for _ in range(2):  # the first call writes, the second only reads
        cached = sensor_model(grid_map(), SETTINGS, tmp_path)
        for ours, theirs in (
            (cached.field.codes, computed.field.codes),
            (cached.field.grid.cells, computed.field.grid.cells),
            (cached.jumps, computed.jumps),
        ):
            np.testing.assert_array_equal(ours, theirs)
            assert ours.dtype == theirs.dtype
        assert cached.field.log_floor == computed.field.log_floor
        assert cached.field.log_step == computed.field.log_step
    array: object = cached.field.codes
    while isinstance(array, np.ndarray) and not isinstance(array, np.memmap):
        array = array.base
    assert isinstance(array, np.memmap), "a view of a view of the file, never a copy"


def test_the_most_recently_used_cache_entries_are_kept(tmp_path: Path) -> None:
    many = [SensorSettings(hit_sigma_m=0.1 + 0.01 * n) for n in range(map_model.KEPT_ENTRIES + 3)]
    for number, settings in enumerate(many):
        for used in (settings, many[0]):  # the first is used all along
            sensor_model(grid_map(), used, tmp_path)
            newest = max(tmp_path.glob("field-*"), key=lambda entry: entry.stat().st_mtime_ns)
            os.utime(newest, ns=(2 * number, 2 * number + (used is many[0])))
    kept = set(tmp_path.glob("field-*"))
    assert len(kept) == map_model.KEPT_ENTRIES
    sensor_model(grid_map(), many[0], tmp_path)
    sensor_model(grid_map(), many[-1], tmp_path)
    assert set(tmp_path.glob("field-*")) == kept
    sensor_model(grid_map(), many[1], tmp_path)
    assert set(tmp_path.glob("field-*")) != kept


def test_another_map_or_other_settings_are_another_entry_but_not_other_landmarks(
    tmp_path: Path,
) -> None:
    tag = Landmark(name="exit", x=1.0, y=2.0, sigma=0.1)
    for landmarks in ((), (tag,)):
        sensor_model(grid_map().with_landmarks(landmarks), SETTINGS, tmp_path)
    sensor_model(grid_map(box=False), SETTINGS, tmp_path)
    sensor_model(grid_map(), SensorSettings(hit_sigma_m=0.3), tmp_path)
    assert len(list(tmp_path.glob("field-*"))) == 3


def test_a_folder_that_cannot_be_written_costs_only_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    in_the_way = tmp_path / "file"
    in_the_way.write_text("not a folder")
    with caplog.at_level(logging.WARNING):
        model = sensor_model(grid_map(), SETTINGS, in_the_way)
    assert "cannot be used" in caplog.text
    assert model.field.codes.shape == (32, 42)


@pytest.mark.parametrize("is_folder", [True, False])
def test_arrays_that_others_may_write_are_not_used(
    tmp_path: Path, is_folder: bool, caplog: pytest.LogCaptureFixture
) -> None:
    model = sensor_model(grid_map(), SETTINGS, tmp_path)
    written = tmp_path if is_folder else next(tmp_path.glob("field-*/codes.npy"))
    written.chmod(0o777)
    with caplog.at_level(logging.WARNING):
        again = sensor_model(grid_map(), SETTINGS, tmp_path)
    assert f"cannot be used: other accounts may write {written}" in caplog.text
    np.testing.assert_array_equal(again.field.codes, model.field.codes)


def test_one_of_many_processes_computes_the_field_and_the_others_read_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    computed: list[GridMap] = []
    compute = map_model._computed

    def counted(grid: GridMap, settings: SensorSettings) -> MapArrays:
        computed.append(grid)
        return compute(grid, settings)

    monkeypatch.setattr(map_model, "_computed", counted)
    with ThreadPoolExecutor(4) as threads:  # a lock on an open file holds between these as well
        models = list(threads.map(lambda _: sensor_model(grid_map(), SETTINGS, tmp_path), range(4)))
    assert len(computed) == 1
    for model in models:
        np.testing.assert_array_equal(model.field.codes, models[0].field.codes)


def test_a_full_disk_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(path: Path, _array: object) -> None:
        path.write_bytes(b"half of i")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np, "save", full)
    with caplog.at_level(logging.WARNING):
        sensor_model(grid_map(), SETTINGS, tmp_path)
    assert "No space left" in caplog.text
    assert [left.name for left in tmp_path.iterdir()] == ["lock"]


def test_files_of_a_killed_process_are_removed_at_the_next_start(tmp_path: Path) -> None:
    left = tmp_path / "tmpabcd.part"
    left.mkdir()
    (left / "codes.npy").write_bytes(b"half of i")
    sensor_model(grid_map(), SETTINGS, tmp_path)
    assert not left.exists()
    assert len(list(tmp_path.glob("field-*"))) == 1
