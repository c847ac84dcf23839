"""`clustermcl changes`: what has changed in the building, and a map with it."""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from clustermcl.changes.collector import ChangeCollector
from clustermcl.changes.new_map import joined, with_changes
from clustermcl.commands import options as opt
from clustermcl.commands.kernels import prepare_kernels
from clustermcl.jobs import in_process
from clustermcl.jobs.map_model import sensor_model
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.errors import SettingsError
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.map_file import load_map_with_obstacles, map_file_of
from clustermcl.recordings.maps.ros_map import save_ros_map
from clustermcl.runtime.folders import kept_folder
from clustermcl.runtime.output_files import OutputError, check_output_file
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import with_setting
from clustermcl.runtime.sources import NEED_MAP
from clustermcl.sensor_bridge.recorded import opened, steps_of
from clustermcl.view.plots import NoExtraError, drawn_changes, save

_log = logging.getLogger(__name__)

_TIMES = 2


@opt.settings_command(*opt.OF_BAGS, "router")
def changes(
    settings: Settings,
    context: typer.Context,
    recording: Annotated[
        Path | None, opt.option("Recording of a robot, in place of a running system.", "FILE")
    ] = None,
    robots: opt.Robots = None,
    map_file: opt.MapOfRecording = None,
    since: Annotated[str | None, opt.option("Only what was seen since: s, m, h, d.", "7d")] = None,
    output: Annotated[Path | None, opt.option("Write the new map.", "FILE.yaml")] = None,
    as_json: opt.AsJson = False,
) -> None:
    """Print what has changed in the building, and write a new map.

    The old map and a picture are written beside the new one. Of several robots, the newest sighting
    of each cell counts.
    """
    since_s = None if since is None else _seconds_of(since)
    files = [] if output is None else _files(output, map_file or settings.bridge.map)
    if recording is None:
        opt.refuse_without("--recording", recording, map=map_file)
        grid_map, found = _of_robots(settings, robots or [settings.robot.name])
    else:
        opt.refuse_given(context, "a recording", "robots", "router")
        named = map_file_of(map_file or "", str(recording))
        if not named:
            raise SettingsError(NEED_MAP)
        grid_map = load_map_with_obstacles(named)
    if files and grid_map.floors:
        problem = "a building is not written: name the map of one floor, and its recording"
        raise SettingsError(key="--output", problem=f"--output {output}: {problem}")
    if recording is not None:
        found = changes_of_recording(recording, grid_map, settings)
    if since_s is not None:
        found = found.seen_within(since_s)
    if files:
        new, old, picture = files
        save_ros_map(grid_map, old)
        save_ros_map(with_changes(grid_map, found), new)
        try:
            save(drawn_changes(grid_map, found, summary(found)), picture)
        except NoExtraError as error:
            _log.warning("%s: not drawn: %s", picture, error)
    opt.print_answer(as_object(found) if as_json else [summary(found)])


def _seconds_of(text: str) -> float:
    """Return a time such as ``90s``, ``15m``, ``2h`` or ``7d`` [s]."""
    unit = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86_400.0}.get(text[-1:])
    if unit is None or not text[:-1].isdecimal() or len(text) > 12:
        raise SettingsError(key="--since", problem=f"--since {text!r}: write such as 90s, 2h or 7d")
    return int(text[:-1]) * unit


def _files(output: Path, map_file: str) -> list[Path]:
    """Return the new map, the old one and the picture; none may replace what another has made."""
    check_output_file(output, ".yaml")
    files = [output, *(output.with_suffix(end) for end in (".old.yaml", ".changes.png"))]
    images = [file.with_suffix(".png") for file in files]
    for file in (*files, *images):
        check_output_file(file)
    is_of_another = not files[1].exists() and (output.exists() or images[0].exists())
    if is_of_another or output.resolve() == Path(map_file).resolve():
        raise OutputError(output, "a map that this command has not written is there; name another")
    return files


def _of_robots(settings: Settings, robots: Sequence[str]) -> tuple[GridMap, Changes]:
    found = []
    for name in robots:
        with opt.connected(with_setting(settings, "robot.name", name, "--robot")) as client:
            found.append(client.changes())
            grid_map = client.map()
    return grid_map, joined(found)


def changes_of_recording(recording: Path, grid_map: GridMap, settings: Settings) -> Changes:
    """Localize with a recording, and collect what has changed since its map was made.

    The second time, the robot is localized in the map with what was found the first time, so that
    more is seen.
    """
    read, shown = opened(str(recording), settings.bridge), grid_map
    prepare_kernels(settings.sensor)
    for _ in range(_TIMES):
        collector = ChangeCollector(grid_map)
        model = sensor_model(shown, settings.sensor, kept_folder("maps"))
        scans = steps_of(read, settings.bridge, grid_map.digest, grid_map.floors)
        for scan, outcome in in_process.outcomes(scans, model, settings):
            collector.on_step(scan, outcome.state, outcome.hypotheses)
        changes = collector.changes("changes")
        shown = with_changes(grid_map, changes)
    return changes


def summary(changes: Changes) -> str:
    gone, new, moving = changes.area_m2
    return (
        f"gone {gone:.2f} m2, new {new:.2f} m2, moving {moving:.2f} m2; "
        f"{changes.seen_share:.0%} of the free ground was seen lately"
    )


def as_object(changes: Changes) -> dict[str, object]:
    names = ("seen_share", "stamp_ns", "map_digest")
    areas_m2 = zip(("gone_m2", "new_m2", "moving_m2"), changes.area_m2, strict=True)
    return {**dict(areas_m2), **{name: getattr(changes, name) for name in names}}
