"""The options that several commands have."""

from pathlib import Path
from typing import Annotated

import typer

from clustermcl import completion

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


def of_bag(scan_topic: str, odom_topic: str, odom_frame: str, base_frame: str) -> list[str]:
    """The settings that say which topics and frames of a bag are meant, where they are named."""
    named = {
        "scan_topic": scan_topic,
        "odom_topic": odom_topic,
        "odom_frame": odom_frame,
        "base_frame": base_frame,
    }
    return [f"bridge.{setting}={name}" for setting, name in named.items() if name]
