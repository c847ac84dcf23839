"""`clustermcl up`: everything on this machine, in the foreground, until Ctrl-C."""

import sys

from clustermcl.stack import ProcessEndedError, Stack, running, temporary_folder
from process_runtime.settings import Settings
from process_runtime.stop import stop_on_signals
from protocol.errors import SettingsError

_POLL_S = 0.1


def run_up(settings: Settings) -> None:
    """Run router, bridge or simulator, coordinator and workers; restart those that die.

    Raises:
        SettingsError: no map is named.
        ProcessEndedError: a process refuses its settings or its input.
    """
    simulated = settings.bridge.source.startswith("sim:")
    if not simulated and not settings.bridge.map:
        raise SettingsError("bridge.map is empty: name the map file there, or by --set bridge.map=")
    stop = stop_on_signals(exit_after_s=5.0)
    with temporary_folder() as folder:
        stack = Stack(settings, folder, logs_in_folder=False)
        with running(stack):
            stack.start_all()
            _say(f"robot {settings.robot.name!r} at {settings.zenoh.router}; Ctrl-C ends it")
            _say("ask with: clustermcl pose")
            while not stop.wait(_POLL_S):
                for ended in stack.ended():
                    if ended.restart_in_s is None:
                        raise ProcessEndedError(ended)
                    _say(
                        f"{ended.name} ended with code {ended.code}; "
                        f"starting it again in {ended.restart_in_s:.1f} s"
                    )


def _say(text: str) -> None:
    sys.stderr.write(f"clustermcl: {text}\n")
    sys.stderr.flush()
