"""`clustermcl snapshot`: save the map and the places where the robot may be as a picture."""

import time
from contextlib import suppress
from pathlib import Path
from typing import Annotated

from msgspec.structs import replace

from clustermcl.client import Client
from clustermcl.commands.options import argument, client_command
from clustermcl.protocol import keys
from clustermcl.protocol.errors import UnreachableError
from clustermcl.protocol.steps import Scan
from clustermcl.runtime.output_files import check_output_file
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.stop import stop_on_signals
from clustermcl.view.plots import draw_map, draw_places, new_figure, save

STANDS_AFTER_S = 2.0
"""Time without a scan after which the robot counts as standing still, and is drawn without one."""


@client_command
def snapshot(
    settings: Settings,
    file: Annotated[Path, argument("FILE.png", "The picture.")],
) -> None:
    """Save a picture of the map and the places."""
    check_output_file(file, ".png")
    figure = new_figure()
    with Client(settings, stop=stop_on_signals()) as client:
        grid_map, scan = client.map(), None
        with suppress(UnreachableError):
            scan = next(client.published(keys.SCAN, Scan, STANDS_AFTER_S))
        answer = client.hypotheses()
    places = tuple(
        replace(place, pose=grid_map.floors.drawn_pose(place.floor, place.pose))
        for place in answer.hypotheses
    )
    pose = answer.pose
    says = {"fresh": pose.state, "none": "no scan yet", "dead_reckoning": "dead reckoning"}
    count = "1 place" if len(places) == 1 else f"{len(places)} places"
    title = f"{settings.robot.name}: {says.get(pose.freshness, pose.freshness)}, {count}"
    (axes,) = figure.axes
    draw_map(axes, grid_map)
    draw_places(axes, places, scan)
    axes.set_title(f"{title}, {time.strftime('%Y-%m-%d %H:%M %Z')}")
    save(figure, file)
