"""Options and behaviour that several commands share."""

import inspect
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Concatenate, ParamSpec

import typer

from clustermcl.as_json import JsonObject, dumped
from clustermcl.verbosity import log_settings
from process_runtime.settings import ROBOT_VARIABLE, ROUTER_VARIABLE, Settings
from process_runtime.settings_file import load_settings
from protocol.errors import SettingsError

if TYPE_CHECKING:
    from clustermcl.client import Client

P = ParamSpec("P")

Robot = Annotated[
    str | None,
    typer.Option("--robot", metavar="NAME", envvar=ROBOT_VARIABLE, help="Robot name (robot.name)."),
]
Router = Annotated[
    str | None,
    typer.Option(
        "--router",
        metavar="ENDPOINT",
        envvar=ROUTER_VARIABLE,
        help="Router endpoint (zenoh.router).",
    ),
]
SettingsFile = Annotated[
    Path | None, typer.Option("--settings", metavar="FILE", help="Settings file (TOML).")
]
Assignments = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="A setting, which overrides the file; may be repeated."
    ),
]
ScanTopic = Annotated[str, typer.Option(metavar="TOPIC", help="Scan topic in a ROS bag.")]
OdomTopic = Annotated[
    str, typer.Option(metavar="TOPIC", help="Odometry topic in a ROS bag, instead of tf.")
]
OdomFrame = Annotated[str, typer.Option(metavar="FRAME", help="Odometry frame in a ROS bag.")]
BaseFrame = Annotated[str, typer.Option(metavar="FRAME", help="The robot's frame in a ROS bag.")]
Listen = Annotated[
    str | None,
    typer.Option(metavar="HOST:PORT", help="Address of the page; by default only on this machine."),
]
RecordFile = Annotated[
    Path | None,
    typer.Option("--record", metavar="FILE.mcap", help="Record the run (MCAP)."),
]
AllowCommands = Annotated[
    bool, typer.Option("--allow-commands", help="Allow commands from other machines too.")
]
HERE = "127.0.0.1"  # with the usual port; the page itself is not imported here
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]
Output = Annotated[
    Path | None,
    typer.Option("--output", metavar="FILE.csv", help="Write the results, one row for each run."),
]


def as_assignments(robot: str | None, router: str | None) -> list[str]:
    """Return assignments of `robot.name` and `zenoh.router` for the options that are given."""
    named = {"robot.name": robot, "zenoh.router": router}
    return [f"{setting}={value}" for setting, value in named.items() if value]


def client_command(command: Callable[Concatenate[Settings, P], None]) -> Callable[..., None]:
    """Return a command that also has the options of a client, and loads the settings."""

    def run(
        *,
        robot: Robot = None,
        router: Router = None,
        settings_file: SettingsFile = None,
        assignments: Assignments = None,
        **own: Any,
    ) -> None:
        given = [*log_settings(), *as_assignments(robot, router), *(assignments or ())]
        # Typer reads the signature set below, so `own` has the command's own options.
        command(load_settings(settings_file, given), **own)  # type: ignore[call-arg]

    return _with_options_of(command, run)


def recording_command(command: Callable[Concatenate[Settings, P], None]) -> Callable[..., None]:
    """Return a command that also has the options of a ROS bag, and loads the settings.

    The returned command raises a `SettingsError` if a topic or frame is given although its
    parameter `recording` is not a bag.
    """

    def run(
        *,
        scan_topic: ScanTopic = "",
        odom_topic: OdomTopic = "",
        odom_frame: OdomFrame = "",
        base_frame: BaseFrame = "",
        settings_file: SettingsFile = None,
        assignments: Assignments = None,
        **own: Any,
    ) -> None:
        named = {
            "scan_topic": scan_topic,
            "odom_topic": odom_topic,
            "odom_frame": odom_frame,
            "base_frame": base_frame,
        }
        if any(named.values()):
            refuse_without("a ROS bag", _may_be_bag(own["recording"]), **named)
        given = [*log_settings(), *(assignments or ())]
        given += [f"bridge.{setting}={name}" for setting, name in named.items() if name]
        command(load_settings(settings_file, given), **own)  # type: ignore[call-arg]

    return _with_options_of(command, run)


def _with_options_of(command: Callable[..., None], run: Callable[..., None]) -> Callable[..., None]:
    """Give `run` the docstring and the options of a command, before those of `run` itself."""
    common = inspect.signature(run).parameters.values()
    own = list(inspect.signature(command).parameters.values())[1:]
    added = [parameter for parameter in common if parameter.kind is not parameter.VAR_KEYWORD]
    setattr(run, "__signature__", inspect.Signature([*own, *added]))  # noqa: B010 - mypy
    run.__doc__ = command.__doc__
    return run


def connected(settings: Settings) -> "Client":
    from clustermcl.client import Client  # noqa: PLC0415 - slower than importing all commands

    return Client(settings)


def print_answer(answer: JsonObject | Iterable[str]) -> None:
    text = dumped(answer) if isinstance(answer, dict) else "\n".join(answer)
    print(text, flush=True)  # noqa: T201 - the command's answer


def refuse_without(needed: str, is_there: object, **options: object) -> None:
    """Refuse options that have no effect unless another one is given.

    Args:
        needed: name of the other option, for the error.
        is_there: true if the other option was given.
        options: values of the options by their Python names; false values: not given.

    Raises:
        SettingsError: an option was given without the other one.
    """
    for name, value in options.items():
        if value and not is_there:
            option = f"--{name.replace('_', '-')}"
            raise SettingsError(key=option, problem=f"{option} has no effect without {needed}")


def _may_be_bag(recording: str | Path | None) -> bool:
    """Return whether a recording is a bag, or a missing file, which is refused later."""
    from process_runtime.sources import SIMULATED  # noqa: PLC0415 - see the package
    from recordings.bag_file import is_bag  # noqa: PLC0415 - takes a while to import

    if not recording or str(recording).startswith(SIMULATED):
        return False
    path = Path(recording)
    return not path.exists() or is_bag(path)


def settings_with_nav2(
    nav2_params: Path | None, settings_file: Path | None, assignments: Sequence[str]
) -> tuple[Settings, list[str]]:
    """Load settings: assignments override the file, and the file overrides nav2's parameters.

    Returns:
        The settings, and a line for each nav2 parameter that has another effect here, or none.

    Raises:
        InputFileError: a file is unreadable or malformed.
        SettingsError: a value is out of range.
    """
    if nav2_params is None:
        return load_settings(settings_file, assignments), []
    from ros2_bridge.nav2_params import read_nav2_params  # noqa: PLC0415 - see the package

    values, notes = read_nav2_params(nav2_params)
    origin = str(nav2_params)
    return load_settings(settings_file, assignments, beneath=values, beneath_from=origin), notes
