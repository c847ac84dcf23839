"""What has changed in the building: the bridge collects it beside the steps, and publishes it."""

import logging
import math
import time
from collections.abc import Iterable
from concurrent.futures import Future
from functools import partial
from pathlib import Path

from msgspec.structs import replace

from clustermcl.changes.keeper import ChangeKeeper
from clustermcl.filter.kernels import library as kernel_library
from clustermcl.filter.settings import SensorSettings
from clustermcl.link.node import Node
from clustermcl.link.wire import Asked
from clustermcl.protocol import errors, keys
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.steps import Scan
from clustermcl.recordings.maps.grid_map import GridMap

RENEW_S = 5.0
"""Least time between two looks at what has changed in the building [s]."""

_log = logging.getLogger(__name__)


class BuildingChanges:
    """Collects the changes in the newest map. In `folder` they are kept; None: they are not."""

    def __init__(self, node: Node, folder: Path | None) -> None:
        self._node, self._folder = node, folder
        self._map: GridMap | None = None
        self._keeper: ChangeKeeper | None = None
        self._collected_s = self._renewed_s = 0.0
        self._changed = node.publisher(keys.CHANGES)
        node.serve(keys.CHANGES, self._on_query)

    def begin(self, grid_map: GridMap) -> None:
        """Collect the changes in this map from now on; kernels are compiled in the background."""
        self._map, self._keeper = grid_map, None
        self._node.in_background(partial(self._begun, grid_map), partial(self._on_begun, grid_map))

    def _begun(self, grid_map: GridMap) -> ChangeKeeper:
        if kernel_library.library() is None:
            from clustermcl.jobs.warm_up import compile_kernels  # noqa: PLC0415 - seldom

            compile_kernels(SensorSettings())
        return ChangeKeeper(grid_map, self._folder, self._node.robot, self._node.name)

    def _on_begun(self, grid_map: GridMap, begun: Future[ChangeKeeper]) -> None:
        try:
            keeper = begun.result()
        except (errors.ClusterMclError, kernel_library.NoKernelsError) as error:
            _log.warning("changes of the building are not collected: %s", error)
            return
        if self._map is grid_map:
            self._keeper = keeper

    def collect(self, scans: Iterable[Scan], belief: Belief) -> None:
        """Collect what the scan of a belief's step shows, if it is one of the newest `scans`."""
        found = (scan for scan in scans if scan.step == belief.step)
        if self._keeper is not None and (scan := next(found, None)) is not None:
            self._keeper.on_step(scan, belief)
            self._collected_s = time.monotonic()

    def renew(self) -> None:
        """Publish changes in a while after they were collected, if there are new ones."""
        is_due = time.monotonic() - self._renewed_s > RENEW_S
        if self._keeper is not None and is_due and self._collected_s > self._renewed_s:
            self._renewed_s = math.inf
            self._node.in_background(self._keeper.renew, partial(self._on_renewed, self._keeper))

    def _on_renewed(self, keeper: ChangeKeeper, renewed: Future[bool]) -> None:
        self._renewed_s = time.monotonic()
        gone, new, moving = keeper.newest.area_m2
        self._node.health.gauges = {
            "gone [m2]": gone, "new [m2]": new, "moving [m2]": moving,
            "share of the map seen lately": keeper.newest.seen_share,
        }  # fmt: skip
        if renewed.result():
            self._changed.put(replace(keeper.newest, zlib_seen_min=b""))

    def _on_query(self, asked: Asked) -> None:
        if self._keeper is None:
            asked.refuse("no changes are collected yet")
        else:
            asked.answer(self._keeper.newest)

    def save(self) -> None:
        if self._keeper is not None:
            self._keeper.save()
