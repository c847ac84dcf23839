"""Options and behaviour that several commands share."""

from collections.abc import Callable, Iterable
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeAlias

import typer

from clustermcl.commands.as_json import JsonObject, dumped
from clustermcl.commands.verbosity import log_settings
from clustermcl.protocol.errors import SettingsError, escaped
from clustermcl.runtime.settings import ROBOT_VARIABLE, ROUTER_VARIABLE, Settings
from clustermcl.runtime.settings_file import load_settings, with_setting
from clustermcl.runtime.sources import SIMULATED

if TYPE_CHECKING:
    from clustermcl.client import Client

Command: TypeAlias = Callable[..., None]


def option(text: str, metavar: str | None = None, *, flag: str = "", **more: Any) -> Any:
    """Return an option with its help; the flag is the parameter's name, unless it is given."""
    return typer.Option(*filter(None, [flag]), metavar=metavar, help=text, **more)


def flag(name: str, text: str) -> Any:
    return typer.Option(name, help=text)


def argument(metavar: str, text: str) -> Any:
    return typer.Argument(metavar=metavar, help=text)


SettingsFile = Annotated[Path | None, option("Settings file (TOML).", "FILE", flag="--settings")]
Assignments = Annotated[
    list[str] | None,
    option("A setting, which overrides the file; may be repeated.", "KEY=VALUE", flag="--set"),
]
_SHARED = {
    "robot": ("robot.name", "NAME", "Robot name (robot.name)."),
    "router": ("zenoh.router", "ENDPOINT", "Router endpoint (zenoh.router)."),
    "scan_topic": ("bridge.scan_topic", "TOPIC", "Scan topic in a ROS bag."),
    "odom_topic": ("bridge.odom_topic", "TOPIC", "Odometry topic in a ROS bag, instead of tf."),
    "odom_frame": ("bridge.odom_frame", "FRAME", "Odometry frame in a ROS bag."),
    "base_frame": ("bridge.base_frame", "FRAME", "The robot's frame in a ROS bag."),
}
"""Setting, metavariable and help of the options that several commands have."""
_VARIABLES = {"robot": ROBOT_VARIABLE, "router": ROUTER_VARIABLE}
OF_BAGS = ("scan_topic", "odom_topic", "odom_frame", "base_frame")
Listen = Annotated[
    str | None, option("Address of the page; by default only on this machine.", "HOST:PORT")
]
AllowCommands = Annotated[bool, flag("--allow-commands", "Allow commands from other machines too.")]
Robots = Annotated[
    list[str] | None,
    option("May be repeated.", "NAME", flag="--robot", envvar=ROBOT_VARIABLE),
]
MapOfRecording = Annotated[str | None, option("Map of the recording.", "FILE", flag="--map")]
HERE = "127.0.0.1"  # with the usual port; the page itself is not imported here
AsJson = Annotated[bool, flag("--json", "Print JSON instead of text.")]
Floor = Annotated[str, option("Floor of a building.", "NAME")]

Above = Annotated[float, option("Only places with a probability above P.", "P", min=0.0, max=1.0)]


class Given(NamedTuple):
    """The settings on a command line."""

    file: Path | None
    assignments: list[str]

    def words(self) -> list[str]:
        """Return the settings as arguments of another program."""
        file = ["--settings", str(self.file)] if self.file else []
        return file + [word for assignment in self.assignments for word in ("--set", assignment)]


def given_command(*shared: str) -> Callable[[Command], Command]:
    """Return a decorator: the command also has the options of settings, and gets a `Given`.

    Args:
        shared: names of further options, whose values become settings.
    """

    def decorated(command: Command) -> Command:
        def run(
            settings_file: SettingsFile = None, assignments: Assignments = None, **own: Any
        ) -> None:
            named = {option: value for option in shared if (value := own.pop(option))}
            if named.keys() & OF_BAGS:
                refuse_without("a ROS bag", _may_be_bag(own["recording"] or ""), **named)
            for option, value in named.items():
                with_setting(Settings(), _SHARED[option][0], value, f"--{option.replace('_', '-')}")
            values = [f"{_SHARED[option][0]}={value}" for option, value in named.items()]
            given = [*log_settings(), *values, *(assignments or ())]
            command(Given(settings_file, given), **own)

        kinds: dict[str, Any] = {}
        for name in shared:
            _, metavar, text = _SHARED[name]
            shown = option(text, metavar, envvar=_VARIABLES.get(name))
            kinds[name] = Annotated[str | None, shown]
        kinds |= {"settings_file": SettingsFile, "assignments": Assignments}
        added = [
            Parameter(n, Parameter.KEYWORD_ONLY, default=None, annotation=kinds[n]) for n in kinds
        ]
        own = list(signature(command).parameters.values())[1:]
        setattr(run, "__signature__", Signature([*own, *added]))  # noqa: B010 - mypy
        run.__doc__ = command.__doc__
        return run

    return decorated


def settings_command(*shared: str) -> Callable[[Command], Command]:
    """Return a decorator as `given_command` does; the command gets the loaded settings."""

    def decorated(command: Command) -> Command:
        @wraps(command)
        def with_settings(given: Given, **own: Any) -> None:
            command(load_settings(given.file, given.assignments), **own)

        return given_command(*shared)(with_settings)

    return decorated


client_command = settings_command("robot", "router")
recording_command = settings_command(*OF_BAGS)


def connected(settings: Settings) -> "Client":
    from clustermcl.client import Client  # noqa: PLC0415 - slower than importing all commands

    return Client(settings)


def print_answer(answer: JsonObject | Iterable[str]) -> None:
    lines = [dumped(answer)] if isinstance(answer, dict) else answer
    print("\n".join(map(escaped, lines)), flush=True)  # noqa: T201 - the command's answer


def _may_be_bag(recording: Path | str) -> bool:
    """Return whether a recording is a bag, or missing, which is refused later."""
    from clustermcl.recordings.bag_file import is_bag  # noqa: PLC0415 - slow to import

    exists = Path(recording).exists() or str(recording).startswith(SIMULATED)
    return not exists or is_bag(Path(recording))


def refuse_without(needed: str, is_there: object, **options: object) -> None:
    """Refuse given options that have no effect without `needed`, unless it is there."""
    for name, value in options.items():
        if value and not is_there:
            option = f"--{name.replace('_', '-')}"
            raise SettingsError(key=option, problem=f"{option} has no effect without {needed}")


def refuse_given(context: typer.Context, what: str, *parameters: str) -> None:
    """Refuse options without effect that are on the command line; the environment may have them."""
    for each in context.command.params:
        source = context.get_parameter_source(each.name or "")
        if each.name in parameters and source and source.name == "COMMANDLINE":
            problem = f"{each.opts[0]} has no effect on {what}; leave it out"
            raise SettingsError(key=each.opts[0], problem=problem)
