"""`clustermcl up`: run all processes of a robot on this machine until Ctrl-C."""

import os
import shlex
import sys
import time
from contextlib import closing
from typing import Annotated, assert_never

from clustermcl.commands import options as opt
from clustermcl.commands.processes import become
from clustermcl.commands.stack import ProcessEndedError, Stack, temporary_folder
from clustermcl.commands.verbosity import say
from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime import sources
from clustermcl.runtime.folders import kept_folder, recording_folder
from clustermcl.runtime.main import outermost
from clustermcl.runtime.parent import die_with_parent
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import load_settings, with_setting
from clustermcl.runtime.stop import stop_on_signals
from clustermcl.runtime.supervisor import ChildExit
from clustermcl.view.admission import parsed_address


@opt.given_command("robot", "router")
def up(
    given: opt.Given,
    view: Annotated[bool, opt.flag("--view", "Also serve the live page.")] = False,
    one_process: Annotated[
        bool, opt.flag("--one-process", "Use one process: less memory, no fault tolerance.")
    ] = False,
    listen: opt.Listen = None,
    allow_commands: opt.AllowCommands = False,
) -> None:
    """Localize a robot: run all processes on this machine until Ctrl-C."""
    opt.refuse_without("--view", view, listen=listen, allow_commands=allow_commands)
    if one_process:
        opt.refuse_without("several processes", None, view=view)
        become("commands.one_process", given)
    settings, page = load_settings(given.file, given.assignments), None
    _check_in_child(settings)
    if not settings.recorder.folder:
        recordings = str(kept_folder("state") / "flight-recorder")
        settings = with_setting(settings, "recorder.folder", recordings, "clustermcl up")
    if view:
        page = ["--listen", parsed_address(listen or opt.HERE).netloc]
        page += ["--allow-commands"] if allow_commands else []
    stop = stop_on_signals()
    with temporary_folder() as folder:
        stack = Stack(settings, folder, logs_in_folder=False, page_arguments=page)
        with closing(stack):
            stack.start_all()
            name, router = settings.robot.name, shlex.quote(settings.zenoh.router)
            say(f"robot {name!r} at {router}; Ctrl-C ends it")
            say(f"query it with: clustermcl pose --robot {name} --router {router}")
            if (recording := recording_folder(settings)) is not None:
                say(f"see what happened with: clustermcl replay {shlex.quote(str(recording))}")
            while not stack.supervisor.wait(stop):
                for ended in stack.supervisor.poll(time.monotonic()):
                    if ended.restart_in_s is None:
                        raise ProcessEndedError(ended)
                    say(
                        f"{ended.name} ended with code {ended.code}; "
                        f"starting it again in {ended.restart_in_s:.1f} s"
                    )


def _check_in_child(settings: Settings) -> None:
    """Check the settings in a child process, whose memory for maps and scipy ends with it.

    Raises:
        SystemExit: the child has printed why the settings are refused.
        ProcessEndedError: the child was killed.
    """
    parent = os.getpid()
    if (child := os.fork()) == 0:
        die_with_parent(parent)
        code = outermost("clustermcl", lambda: _check(settings))
        sys.stderr.flush()
        os._exit(code)
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code < 0:
        why = "the map may need more memory than there is"
        raise ProcessEndedError(ChildExit("settings check", code, None, why))
    if code:
        raise SystemExit(code)


def _check(settings: Settings) -> None:
    """Raise an error if a process could not start, before any is started."""
    from clustermcl.link.configuration import as_zenoh, client_configuration  # noqa: PLC0415
    from clustermcl.recordings.recording import open_recording  # noqa: PLC0415 - for the child only
    from clustermcl.simulator.worlds.catalogue import simulated_world  # noqa: PLC0415

    as_zenoh(client_configuration(settings.zenoh, settings.robot))
    bridge = settings.bridge
    match sources.parsed_source(bridge.source):
        case sources.Simulated() as robot:
            simulated_world(robot)
        case sources.Recorded(path):
            _check_map(bridge.map, path)
            open_recording(path, bridge)
        case sources.Live():
            if not sources.is_published(bridge.map, bridge.source):
                _check_map(bridge.map)
        case choice:
            assert_never(choice)


def _check_map(named: str, recording: str = "") -> None:
    from clustermcl.recordings.maps.map_file import load_map_with_obstacles, map_file_of  # noqa: PLC0415

    map_file = map_file_of(named, recording) if recording else named
    if not map_file:
        raise SettingsError(key="bridge.map", problem=sources.NO_MAP)
    load_map_with_obstacles(map_file)
