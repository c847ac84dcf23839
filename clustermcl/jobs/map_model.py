"""Computes the sensor model of a map, whose arrays all workers share by a cache on disk."""

import fcntl
import hashlib
import logging
import os
import shutil
import tempfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from clustermcl.filter.kernels.folders import why_untrusted
from clustermcl.filter.laser.sensor_model import MapArrays, SensorModel
from clustermcl.filter.settings import SensorSettings
from clustermcl.protocol.conversion import decoded
from clustermcl.recordings.maps.grid_map import GridMap

CACHE_VERSION = 8
"""To be increased when the same map and settings give other arrays."""
KEPT_ENTRIES = 16
"""Number of entries kept; each change of settings while a robot drives makes a new one."""

_CELLS = "cells"
_ENTRY = "field-"
_SUMS, _PART = "checksums.json", ".part"

_log = logging.getLogger(__name__)


def sensor_model(
    grid_map: GridMap, settings: SensorSettings, cache_folder: Path | None
) -> SensorModel:
    """Return the sensor model of a map.

    Its arrays are computed once, written to the cache folder, and mapped from there, so that the
    processes of a machine share one copy. A folder that cannot be used costs a warning and a copy
    for each process.

    Raises:
        ValueError: the map has no obstacle.
    """
    if cache_folder is not None:
        entry = cache_folder / _name(grid_map, settings)
        try:
            return _model(_cached(entry, grid_map, settings), grid_map, settings)
        except (OSError, EOFError) as error:
            _log.warning("the cache in %s cannot be used: %s", cache_folder, error)
            shutil.rmtree(entry, ignore_errors=True)
    return _model(_computed(grid_map, settings), grid_map, settings)


def _cached(entry: Path, grid_map: GridMap, settings: SensorSettings) -> MapArrays:
    """Return the arrays of a cache entry, which is written if there is none."""
    folder = entry.parent
    folder.mkdir(parents=True, exist_ok=True)
    if problem := why_untrusted(folder):
        raise OSError(problem)
    with (folder / "lock").open("w") as lock:
        # Twelve processes that compute at once need twelve times the memory.
        fcntl.flock(lock, fcntl.LOCK_EX)  # held until the file is closed
        for left in folder.glob(f"*{_PART}"):  # by killed processes
            shutil.rmtree(left, ignore_errors=True)
        if not entry.is_dir():
            _write(entry, _computed(grid_map, settings))
            _remove_oldest(entry)
        with suppress(OSError):  # the entry may belong to another account
            os.utime(entry)  # marks the entry as recently used
        return _read(entry)


def _computed(grid_map: GridMap, settings: SensorSettings) -> MapArrays:
    return {_CELLS: grid_map.grid.cells, **SensorModel.arrays_of(grid_map.grid, settings)}


def _model(arrays: MapArrays, grid_map: GridMap, settings: SensorSettings) -> SensorModel:
    try:
        cells = arrays[_CELLS]
        if cells.shape != grid_map.cells.shape:
            raise ValueError(f"cells are {cells.shape}, expected {grid_map.cells.shape}")
        grid = replace(grid_map.grid, cells=cells)
        return SensorModel.from_arrays(grid, arrays, settings)
    except (KeyError, ValueError) as error:
        raise OSError(f"not the arrays of this map: {error}") from error


def _name(grid_map: GridMap, settings: SensorSettings) -> str:
    numbers = msgspec.json.encode(settings, order="deterministic")
    text = f"{CACHE_VERSION} {grid_map.cells_digest} ".encode() + numbers
    return f"{_ENTRY}{hashlib.sha256(text).hexdigest()[:32]}"


def _write(entry: Path, arrays: MapArrays) -> None:
    """Write all arrays into a folder, which appears only when complete."""
    part = Path(tempfile.mkdtemp(dir=entry.parent, suffix=_PART))
    try:
        for name, array in arrays.items():
            np.save(_file(part, name), array)
        sums = {name: _checksum(_file(part, name)) for name in arrays}
        (part / _SUMS).write_bytes(msgspec.json.encode(sums))
        part.rename(entry)
    finally:
        shutil.rmtree(part, ignore_errors=True)  # exists only if writing failed


def _remove_oldest(written: Path) -> None:
    """Remove the least recently used entries but the one just written, whatever the clock says.

    A process that has mapped one keeps it.
    """
    entries = sorted(written.parent.glob(f"{_ENTRY}*"), key=lambda one: one.stat().st_mtime)
    entries.remove(written)
    for entry in entries[: 1 - KEPT_ENTRIES]:
        shutil.rmtree(entry, ignore_errors=True)


def _checksum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "blake2b").hexdigest()


def _file(entry: Path, name: str) -> Path:
    return entry / f"{name}.npy"


def _read(entry: Path) -> MapArrays:
    """Map all arrays from disk.

    Raises:
        OSError: a file is damaged, as by a power cut, or others may write it. Kernels use the
            numbers as indices without bounds checks.
    """
    try:
        sums = decoded((entry / _SUMS).read_bytes(), dict[str, str], msgspec.json)
        for name, expected in sums.items():
            if _checksum(_file(entry, name)) != expected:
                raise OSError(f"{entry.name}/{name}.npy is damaged")
            if problem := why_untrusted(_file(entry, name)):
                raise OSError(problem)
        return {name: np.load(_file(entry, name), mmap_mode="r") for name in sums}
    except (msgspec.MsgspecError, ValueError) as error:  # the file may not even be UTF-8
        raise OSError(f"{entry.name}: {error}") from error
