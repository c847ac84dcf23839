"""`clustermcl view RECORDING`: serve the page of a recorded run, or save it."""

from pathlib import Path

from grid_maps.map_message import to_message
from live_view.page_server import PageOptions, opened_page
from live_view.recorded_run import RecordedRun
from process_runtime.output_files import check_output_file, write_output_file
from process_runtime.stop import stop_on_signals
from protocol.errors import RecordingError
from recordings.map_file import load_map
from recordings.run_log import is_run_log


def view_recording(
    recording: Path, page: PageOptions, map_file: Path | None = None, save_file: Path | None = None
) -> None:
    """Serve the page of a recorded run until Ctrl-C, or save the page.

    Args:
        recording: a run log, or a folder with run logs.
        page: address and features of the page.
        map_file: map of the recording; None: the map in the recording.
        save_file: file for the recording as one page, which is then not served; None: serve it.

    Raises:
        SettingsError: the address or a certificate is invalid.
        InputFileError: there is no recording, or it cannot be read.
        MapFileError: the map cannot be read.
        OutputError: the page cannot be written.
    """
    stop = stop_on_signals()
    if not is_run_log(recording):
        problem = "is no recorded run: neither clustermcl record nor a coordinator wrote it"
        remedy = f"localize in it by: clustermcl demo --view --recording {recording}"
        raise RecordingError(recording, f"{problem}; {remedy}")
    named = to_message(load_map(map_file), "recording") if map_file else None
    run = RecordedRun(recording, named)
    if save_file is None:
        with opened_page(page, [run.room]):
            run.run(stop)
    else:
        check_output_file(save_file)
        write_output_file(save_file, run.saved())
