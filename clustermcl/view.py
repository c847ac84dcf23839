"""`clustermcl view`: serve the page that shows the clusters, until Ctrl-C."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from grid_maps.map_message import to_message
from live_view.admission import parsed_address
from live_view.page_server import PageOptions
from live_view.process import serve_page
from live_view.recorded_run import RecordedRun, serve_recording
from process_runtime.output_files import check_output_file, write_output_file
from process_runtime.settings import Settings
from process_runtime.stop import stop_on_signals
from protocol.errors import RecordingError
from recordings.map_file import load_map
from recordings.run_log import is_run_log


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """Options of the command."""

    listen: str
    allow_commands: bool = False
    open_browser: bool = False
    certificate: Path | None = None
    private_key: Path | None = None
    robots: Sequence[str] = ()
    """Names of robots; empty: the one in the settings."""
    recording: Path | None = None
    """A run log, or a folder of them; None: show a running system."""
    map_file: Path | None = None
    """Map of the recording; None: the one in it."""
    save_file: Path | None = None
    """Write the recording as a page instead of serving it; None: serve it."""


def run_view(settings: Settings, options: ViewOptions) -> None:
    """Serve the page of a running system or of a recording, or save a recording as a page.

    The page of a running system waits for it, at the start and when the connection is lost.

    Raises:
        SettingsError: the address, a certificate or a name is invalid.
        InputFileError: there is no recording, or it cannot be read.
        MapFileError: the map of the recording cannot be read.
        OutputError: the page cannot be written.
    """
    page = PageOptions(
        address=parsed_address(options.listen),
        allow_commands=options.allow_commands,
        open_browser=options.open_browser,
        certificate=options.certificate,
        private_key=options.private_key,
    )
    if options.recording is None:
        serve_page(settings, stop_on_signals(), page, say_link, robots=options.robots)
        return
    path = options.recording
    if not is_run_log(path):
        problem = "is no recorded run: neither clustermcl record nor a coordinator wrote it"
        remedy = f"localize in it by: clustermcl demo --view --recording {path}"
        raise RecordingError(path, f"{problem}; {remedy}")
    named = to_message(load_map(options.map_file), "recording") if options.map_file else None
    run = RecordedRun(path, named)
    if options.save_file is None:
        serve_recording(run, stop_on_signals(), page, say_link)
        return
    check_output_file(options.save_file)
    write_output_file(options.save_file, run.saved())


def say_link(link: str) -> None:
    """Print the link of the page."""
    _say(f"look at {link}")


def _say(text: str) -> None:
    sys.stderr.write(f"clustermcl: {text}\n")
    sys.stderr.flush()
