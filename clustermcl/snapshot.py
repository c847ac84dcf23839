"""`clustermcl snapshot`: save the current state as a picture or a page."""

from datetime import UTC, datetime
from pathlib import Path

from live_view.drawing import drawn_picture
from live_view.saved_page import saved_page
from live_view.snapshot import looked_at
from process_runtime.output_files import check_output_file, write_output_file
from process_runtime.settings import Settings
from process_runtime.stop import stop_on_signals
from protocol.errors import SettingsError

KINDS = (".png", ".html")


def save_snapshot(file: Path, settings: Settings) -> None:
    """Look at a running system, and write what is to be seen.

    Args:
        file: a name that ends in ``.png`` or ``.html``; the page needs no server and no network.
        settings: the router's endpoint and the robot's name.

    Raises:
        SettingsError: the name ends otherwise.
        UnreachableError: there is no such system.
        OutputError: the file cannot be written.
    """
    if file.suffix.lower() not in KINDS:
        problem = f"{file}: a snapshot is a .png or a .html file"
        raise SettingsError(key="FILE", problem=problem)
    check_output_file(file)
    frames, grid_map = looked_at(settings, stop_on_signals())
    if file.suffix.lower() == ".png":
        drawn_picture(grid_map, frames["step"]).save(file)
    else:
        now = f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC"
        write_output_file(file, saved_page(frames, grid_map, now))
