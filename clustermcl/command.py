"""The command a person types. Each command imports what it needs, so that `pose` starts fast."""

import logging
import math
import signal
import sys
from collections.abc import Callable
from importlib.metadata import entry_points, version
from pathlib import Path
from typing import Annotated

import typer

from clustermcl import completion
from clustermcl.loudness import LoudCommands, log_settings, set_loudness
from evaluation.experiments.command import MOST_JOBS, MOST_RUNS, experiments
from process_runtime.main import EXIT_ERROR
from process_runtime.output import written_output
from process_runtime.settings_file import load_settings
from process_runtime.stop import StoppedError
from protocol.errors import ClusterMclError

EXIT_INTERRUPTED = 130
EXIT_DIFFERENT = 1
MOST_STEPS = 100_000
"""Of an evaluated run: 20 km of driving. What is measured is kept until its end."""

app = typer.Typer(
    help="Global localization that keeps every possible place: Cluster-MCL over Zenoh.",
    cls=LoudCommands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command()(experiments)
for _command in entry_points(group="clustermcl.commands"):  # of packages above this one
    app.command(_command.name)(_command.load())


def _say_version(asked: bool) -> None:
    if asked:
        sys.stdout.write(f"clustermcl {version('clustermcl')}\n")
        raise typer.Exit


@app.callback()
def _common(
    _version: Annotated[
        bool,
        typer.Option("--version", callback=_say_version, is_eager=True, help="Say it and exit."),
    ] = False,
) -> None:
    """Take what stands before the command."""


SettingsFile = Annotated[
    Path | None, typer.Option("--settings", metavar="FILE", help="Settings file (TOML).")
]
Assignments = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="A setting, over the file's; may be repeated.",
        autocompletion=completion.settings,
    ),
]
ScanTopic = Annotated[str, typer.Option(metavar="TOPIC", help="The laser's, of a ROS bag.")]
OdomTopic = Annotated[str, typer.Option(metavar="TOPIC", help="Odometry of a ROS bag, not tf's.")]
OdomFrame = Annotated[str, typer.Option(metavar="FRAME", help="tf's odometry frame, of a ROS bag.")]
BaseFrame = Annotated[str, typer.Option(metavar="FRAME", help="The robot's frame, of a ROS bag.")]
Listen = Annotated[
    str, typer.Option(metavar="HOST:PORT", help="Where the page is served; a browser opens it.")
]
RecordFile = Annotated[
    Path | None,
    typer.Option("--record", metavar="FILE.mcap", help="Record the run there, as a rosbag2."),
]
AllowCommands = Annotated[
    bool, typer.Option("--allow-commands", help="Show the buttons on other addresses too.")
]
HERE = "127.0.0.1"  # with the usual port; the page itself is not imported here
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]


def main() -> None:
    """Run the command; errors that a person can mend are one line and exit code 2."""
    set_loudness()
    try:
        with written_output():
            app()
    except StoppedError:
        sys.exit(EXIT_INTERRUPTED)
    except ClusterMclError as error:
        sys.stderr.write(f"clustermcl: {' '.join(str(error).split())}\n")
        sys.exit(EXIT_ERROR)
    except BrokenPipeError:  # the reader of a pipe has seen enough
        sys.stderr.close()
        sys.exit(EXIT_INTERRUPTED)


@app.command()
def demo(
    recording: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="Recording, or sim:WORLD, or sim:MAP.yaml.",
            autocompletion=completion.recordings,
        ),
    ] = None,
    map_file: Annotated[
        str | None,
        typer.Option(
            "--map",
            metavar="FILE",
            help="Map of the recording; without one, a simulated robot drives in this map.",
        ),
    ] = None,
    reference: Annotated[
        Path | None, typer.Option(metavar="FILE.tum", help="True trajectory, to compare with.")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Worker processes.")] = None,
    rate: Annotated[
        float | None,
        typer.Option(min=0.0, help="1: real time, 2: twice as fast, 0: as the workers follow."),
    ] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Steps of a simulated robot.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of all random numbers.")] = None,
    scan_topic: ScanTopic = "",
    odom_topic: OdomTopic = "",
    odom_frame: OdomFrame = "",
    base_frame: BaseFrame = "",
    view: Annotated[
        bool, typer.Option("--view", help="Serve a page that draws it; runs on until Ctrl-C.")
    ] = False,
    drive: Annotated[
        bool, typer.Option("--drive", help="With --view: drive the robot with the arrow keys.")
    ] = False,
    listen: Listen = HERE,
    record_file: RecordFile = None,
    as_json: AsJson = False,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Start everything on this machine and watch it localize; without options, a simulation."""
    from clustermcl.demo import DemoOptions, run_demo  # noqa: PLC0415 - see the module

    given = [*log_settings(), *(assignments or ())]
    given += _of_bag(scan_topic, odom_topic, odom_frame, base_frame)
    given += [f"worker.count={workers}"] if workers else []
    given += [f"seed={seed}"] if seed is not None else []
    options = DemoOptions(
        recording=recording,
        map_file=map_file,
        reference=reference,
        rate=rate,
        steps=steps,
        view_at=listen if view else None,
        record=record_file,
        by_hand=drive,
        as_json=as_json,
    )
    run_demo(options, load_settings(settings_file, given))


@app.command()
def up(
    nav2_params: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="AMCL's parameters, from a nav2_params.yaml."),
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Serve a page that draws it, too.")] = False,
    listen: Listen = HERE,
    allow_commands: AllowCommands = False,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Run everything on this machine, in the foreground, until Ctrl-C."""
    from clustermcl.nav2 import settings_with_nav2  # noqa: PLC0415 - see the module
    from clustermcl.up import run_up  # noqa: PLC0415 - see the module

    given = [*log_settings(), *(assignments or ())]
    chosen, without_effect = settings_with_nav2(nav2_params, settings_file, given)
    for line in without_effect:
        sys.stderr.write(f"clustermcl: {line}\n")
    run_up(chosen, view_at=listen if view else None, allow_commands=allow_commands)


@app.command()
def ros2(settings_file: SettingsFile = None, assignments: Assignments = None) -> None:
    """Stand in for nav2's AMCL on a ROS 2 robot over rmw_zenoh, until Ctrl-C."""
    from process_runtime.stop import stop_on_signals  # noqa: PLC0415 - see the module
    from ros2_bridge.process import serve  # noqa: PLC0415 - see the module

    chosen = load_settings(settings_file, [*log_settings(), *(assignments or ())])
    serve(chosen, "ros2_bridge", stop_on_signals())


@app.command()
def evaluate(
    recording: Annotated[
        str,
        typer.Argument(
            metavar="RECORDING",
            help="Recording, sim:WORLD or sim:MAP.yaml.",
            autocompletion=completion.recordings,
        ),
    ],
    map_file: Annotated[
        str | None, typer.Option("--map", metavar="FILE", help="Map of the recording.")
    ] = None,
    reference: Annotated[
        Path | None, typer.Option(metavar="FILE.tum", help="True trajectory, to compare with.")
    ] = None,
    algorithm: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="cluster-mcl; ordinary: mcl, mcl-visibility, amcl, ...",
            autocompletion=completion.algorithms,
        ),
    ] = "cluster-mcl",
    seeds: Annotated[
        int,
        typer.Option(min=1, max=MOST_RUNS, help="Runs; the first has the settings' seed."),
    ] = 1,
    starts: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=MOST_RUNS,
            help="Begin at so many steps, spread over the recording; simulated: so many seeds.",
        ),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=MOST_STEPS,
            help="Steps of a simulated robot, or at most so many; with --starts 60, if left out.",
        ),
    ] = None,
    kidnap_at: Annotated[
        int | None, typer.Option(min=0, help="Lift a simulated robot elsewhere after this step.")
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, max=MOST_JOBS, help="Runs at a time; left out: one for each core."),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the results there.")
    ] = None,
    record_file: RecordFile = None,
    report_file: Annotated[
        Path | None, typer.Option("--report", metavar="FILE.html", help="Draw the runs on a page.")
    ] = None,
    scan_topic: ScanTopic = "",
    odom_topic: OdomTopic = "",
    odom_frame: OdomFrame = "",
    base_frame: BaseFrame = "",
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Localize in one process, without Zenoh, as fast as it goes, and measure how well."""
    from evaluation.evaluate import EvaluateOptions, run_evaluate  # noqa: PLC0415 - see the module

    options = EvaluateOptions(
        recording=recording,
        map_file=map_file,
        reference=reference,
        algorithm=algorithm,
        seeds=seeds,
        starts=starts,
        steps=steps,
        kidnap_at=kidnap_at,
        jobs=jobs,
        json_file=json_file,
        record=record_file,
        report_file=report_file,
    )
    given = [*(assignments or ()), *_of_bag(scan_topic, odom_topic, odom_frame, base_frame)]
    run_evaluate(options, load_settings(settings_file, given))


def _of_bag(scan_topic: str, odom_topic: str, odom_frame: str, base_frame: str) -> list[str]:
    """The settings that say which topics and frames of a bag are meant, where they are named."""
    named = {
        "scan_topic": scan_topic,
        "odom_topic": odom_topic,
        "odom_frame": odom_frame,
        "base_frame": base_frame,
    }
    return [f"bridge.{setting}={name}" for setting, name in named.items() if name]


@app.command()
def check(
    map_file: Annotated[str, typer.Argument(metavar="MAP", help="The map's file.")],
    recording: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Of a robot in that map.")
    ] = None,
    laser_range_m: Annotated[
        float, typer.Option("--range", min=0.5, metavar="M", help="How far the laser sees [m].")
    ] = 12.0,
    places: Annotated[int, typer.Option(min=1, max=1_000, help="Places that are looked at.")] = 24,
    scan_topic: ScanTopic = "",
    odom_topic: OdomTopic = "",
    odom_frame: OdomFrame = "",
    base_frame: BaseFrame = "",
    as_json: AsJson = False,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Is a map fit for localizing; which places look alike; does a recording agree with it."""
    from clustermcl.check import run_check  # noqa: PLC0415 - see the module

    given = [*(assignments or ()), *_of_bag(scan_topic, odom_topic, odom_frame, base_frame)]
    run_check(
        map_file,
        recording,
        load_settings(settings_file, given),
        laser_range_m=laser_range_m,
        places=places,
        as_json=as_json,
    )


@app.command()
def pose(
    as_json: AsJson = False, settings_file: SettingsFile = None, assignments: Assignments = None
) -> None:
    """Where the robot is now, how surely, and how old the data is."""
    from clustermcl.questions import print_pose  # noqa: PLC0415 - see the module

    print_pose(load_settings(settings_file, assignments or ()), as_json=as_json)


@app.command()
def hypotheses(
    above: Annotated[
        float, typer.Option(min=0.0, max=1.0, metavar="P", help="Only places above P.")
    ] = 0.0,
    as_json: AsJson = False,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """All places where the robot may be, with their probabilities."""
    from clustermcl.questions import print_hypotheses  # noqa: PLC0415 - see the module

    settings = load_settings(settings_file, assignments or ())
    print_hypotheses(settings, above=above, as_json=as_json)


@app.command()
def events(
    follow: Annotated[
        bool, typer.Option("--follow", help="And each from now on, until Ctrl-C.")
    ] = False,
    as_json: AsJson = False,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Which clusters and searches began and ended of late, and why."""
    from clustermcl.questions import follow_events, print_events  # noqa: PLC0415 - see the module

    settings = load_settings(settings_file, assignments or ())
    if follow:
        _until_interrupted(lambda: follow_events(settings, as_json=as_json))
    else:
        print_events(settings, as_json=as_json)


@app.command()
def status(
    as_json: AsJson = False, settings_file: SettingsFile = None, assignments: Assignments = None
) -> None:
    """How the system is: steps, workers, what was dropped or refused."""
    from clustermcl.questions import print_status  # noqa: PLC0415 - see the module

    print_status(load_settings(settings_file, assignments or ()), as_json=as_json)


@app.command()
def watch(
    as_json: AsJson = False, settings_file: SettingsFile = None, assignments: Assignments = None
) -> None:
    """Every belief from now on, until Ctrl-C."""
    from clustermcl.questions import watch as stream  # noqa: PLC0415 - see the module

    _until_interrupted(
        lambda: stream(load_settings(settings_file, assignments or ()), as_json=as_json)
    )


@app.command("view")
def serve_view(
    recording: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FILE.mcap|FOLDER]",
            help="A finished run, of 'record' or of the flight recorder, instead of a live one.",
        ),
    ] = None,
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="FILE", help="Map of the recording.")
    ] = None,
    open_browser: Annotated[
        bool, typer.Option("--open", help="Open the page in this machine's browser.")
    ] = False,
    listen: Listen = HERE,
    allow_commands: AllowCommands = False,
    certificate: Annotated[
        Path | None, typer.Option(metavar="FILE", help="PEM: serve the page by HTTPS.")
    ] = None,
    private_key: Annotated[
        Path | None, typer.Option(metavar="FILE", help="PEM, of the certificate.")
    ] = None,
    robots: Annotated[
        list[str] | None,
        typer.Option("--robot", metavar="NAME", help="Instead of robot.name; may be repeated."),
    ] = None,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Serve a page that draws all places where the robot may be, live, until Ctrl-C."""
    from clustermcl.view import ViewOptions, run_view  # noqa: PLC0415 - see the module

    options = ViewOptions(
        listen=listen,
        allow_commands=allow_commands,
        open_browser=open_browser,
        certificate=certificate,
        private_key=private_key,
        robots=robots or (),
        recording=recording,
        map_file=map_file,
    )
    run_view(load_settings(settings_file, assignments or ()), options)


@app.command()
def snapshot(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="NAME.png, or a page: NAME.html.")],
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Save what is to be seen now: a picture, or a page that needs no server."""
    from clustermcl.snapshot import save_snapshot  # noqa: PLC0415 - see the module

    save_snapshot(file, load_settings(settings_file, assignments or ()))


@app.command("set-pose", context_settings={"ignore_unknown_options": True})  # such as -2.5
def set_pose(
    x_m: Annotated[float, typer.Argument(metavar="X", help="In the map [m].")],
    y_m: Annotated[float, typer.Argument(metavar="Y", help="In the map [m].")],
    heading_rad: Annotated[float, typer.Argument(metavar="HEADING", help="In the map [rad].")],
    position_sigma_m: Annotated[
        float, typer.Option(help="Standard deviation of x and of y [m].")
    ] = 0.5,
    heading_sigma_rad: Annotated[
        float, typer.Option(help="Standard deviation of the heading [rad].")
    ] = 0.26,
    covariance: Annotated[
        tuple[float, float, float, float, float, float] | None,
        typer.Option(
            metavar="XX XY XH YY YH HH",
            help="Covariance instead, H being the heading [m2, m rad, rad2].",
        ),
    ] = None,
    stamp_ns: Annotated[
        int | None,
        typer.Option(help="It was there at this time of its clock, and has driven on since [ns]."),
    ] = None,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Say where the robot is."""
    numbers = (x_m, y_m, heading_rad, position_sigma_m, heading_sigma_rad)
    if not all(map(math.isfinite, numbers)) or min(position_sigma_m, heading_sigma_rad) <= 0.0:
        raise typer.BadParameter("a pose is finite numbers, a standard deviation is positive")
    from clustermcl.questions import set_pose as tell  # noqa: PLC0415 - see the module

    try:
        tell(
            load_settings(settings_file, assignments or ()),
            (x_m, y_m, heading_rad),
            position_sigma_m=position_sigma_m,
            heading_sigma_rad=heading_sigma_rad,
            covariance=_symmetric(*covariance) if covariance else None,
            stamp_ns=stamp_ns,
        )
    except ValueError as problem:
        raise typer.BadParameter(str(problem)) from None


def _symmetric(
    xx: float, xy: float, xh: float, yy: float, yh: float, hh: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    return (xx, xy, xh, xy, yy, yh, xh, yh, hh)


@app.command()
def relocalize(
    near: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="X Y RADIUS", help="Search in this circle only [m]."),
    ] = None,
    region: Annotated[
        str, typer.Option(metavar="NAME", help="Search in this one of search.regions only.")
    ] = "",
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Forget all places and search everywhere, near a place, or in a region."""
    if near is not None and not (all(map(math.isfinite, near)) and near[2] > 0.0):
        raise typer.BadParameter("a circle is two finite numbers and a positive radius")
    from clustermcl.questions import relocalize as tell  # noqa: PLC0415 - see the module

    tell(load_settings(settings_file, assignments or ()), near, region)


@app.command()
def update(settings_file: SettingsFile = None, assignments: Assignments = None) -> None:
    """Make a step of the next scan, also if the robot stands still."""
    from clustermcl.questions import update as tell  # noqa: PLC0415 - see the module

    tell(load_settings(settings_file, assignments or ()))


@app.command()
def kidnap(settings_file: SettingsFile = None, assignments: Assignments = None) -> None:
    """Lift the simulated robot to somewhere far away."""
    from clustermcl.questions import kidnap as tell  # noqa: PLC0415 - see the module

    tell(load_settings(settings_file, assignments or ()))


@app.command()
def record(
    file: Annotated[
        Path, typer.Argument(metavar="FILE.mcap", help="Written as a rosbag2, over what is there.")
    ],
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Record map, scans, odometry and beliefs of a running system, until Ctrl-C."""
    from clustermcl.record import run_record  # noqa: PLC0415 - see the module

    steps = run_record(load_settings(settings_file, assignments or ()), file)
    sys.stdout.write(f"{file}: {steps} steps\n")


@app.command()
def replay(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A robot's flight recording.")],
    first_step: Annotated[
        int | None, typer.Option("--from", metavar="STEP", help="Print from this step on.")
    ] = None,
    last_step: Annotated[
        int | None, typer.Option("--to", metavar="STEP", help="Print up to this step.")
    ] = None,
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="FILE", help="Refuse what is of another map.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compute recorded beliefs again, compare them, and print what happened.

    Exit code 1 if a belief is not the recorded one, bit for bit.
    """
    from clustermcl.replay import print_replay  # noqa: PLC0415 - see the module

    same = print_replay(
        folder, first_step=first_step, last_step=last_step, map_file=map_file, as_json=as_json
    )
    sys.exit(0 if same else EXIT_DIFFERENT)


@app.command()
def settings(
    from_nav2: Annotated[
        Path | None, typer.Option(metavar="FILE", help="What a nav2_params.yaml becomes.")
    ] = None,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """All settings with default, unit and meaning, as TOML that can be fed back."""
    from clustermcl.nav2 import settings_with_nav2  # noqa: PLC0415 - see the module
    from process_runtime.settings_table import settings_as_toml  # noqa: PLC0415 - see the module

    chosen, without_effect = settings_with_nav2(from_nav2, settings_file, assignments or ())
    sys.stdout.writelines(f"# {line}\n" for line in without_effect)
    sys.stdout.write(settings_as_toml(chosen))


def _until_interrupted(action: Callable[[], None]) -> None:
    """Run what has no end of its own; Ctrl-C is how a person ends it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        action()
    except KeyboardInterrupt:
        logging.getLogger(__name__).debug("interrupted")
