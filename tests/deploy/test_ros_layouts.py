import runpy
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import typer
import yaml

from clustermcl.commands.command import app
from clustermcl.ros2.topics import Topics
from clustermcl.runtime.ros2_settings import Ros2Settings

DEPLOY = Path(__file__).parents[2] / "deploy"
SHOWS = {
    "rviz_default_plugins/Map": "nav_msgs/msg/OccupancyGrid",
    "rviz_default_plugins/LaserScan": "sensor_msgs/msg/LaserScan",
    "nav2_rviz_plugins/ParticleCloud": "nav2_msgs/msg/ParticleCloud",
    "rviz_default_plugins/MarkerArray": "visualization_msgs/msg/MarkerArray",
    "rviz_default_plugins/PoseWithCovariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "rviz_default_plugins/SetInitialPose": "geometry_msgs/msg/PoseWithCovarianceStamped",
}
NODE = Topics(Ros2Settings())
OURS = {f"/{topic.name}".replace("/~/", "/amcl/"): topic for topic in (*NODE.read(), *NODE.sent())}


def test_rviz_subscribes_to_what_the_bridge_and_the_robot_publish() -> None:
    manager = yaml.safe_load((DEPLOY / "clustermcl.rviz").read_text())["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "map"
    shown = [*manager["Displays"], *(tool for tool in manager["Tools"] if "Topic" in tool)]
    for display in shown:
        topic = OURS[display["Topic"]["Value"]]
        assert topic.ros_type == SHOWS[display["Class"]]
        is_latched = display["Topic"]["Durability Policy"] == "Transient Local"
        assert is_latched == topic.qos.latched, "an RViz that starts later gets the last message"
        if topic.qos.best_effort:
            assert display["Topic"]["Reliability Policy"] == "Best Effort"
    assert {display["Topic"]["Value"] for display in shown} >= {"/map", "/scan", "/amcl/hypotheses"}


class Made:
    def __init__(self, *arguments: Any, **named: Any) -> None:
        self.arguments, self.named = arguments, named


def test_the_launch_file_starts_us_in_the_place_of_amcl(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("launch", "launch.actions", "launch.substitutions", "launch_ros.actions"):
        module = ModuleType(name)
        for made in ("LaunchDescription", "DeclareLaunchArgument", "ExecuteProcess", "Node"):
            setattr(module, made, type(made, (Made,), {}))
        setattr(module, "LaunchConfiguration", lambda argument: f"<{argument}>")  # noqa: B010 - mypy
        monkeypatch.setitem(sys.modules, name, module)
    described = runpy.run_path(str(DEPLOY / "localization.launch.py"))[
        "generate_launch_description"
    ]
    actions = described().arguments[0]
    declared = {a.arguments[0] for a in actions if type(a).__name__ == "DeclareLaunchArgument"}
    assert declared == {"map", "params_file", "use_sim_time", "clustermcl"}
    (command,) = (a.named["cmd"] for a in actions if type(a).__name__ == "ExecuteProcess")
    assert command[:2] == ["<clustermcl>", "up"]
    group = typer.main.get_command(app)
    assert isinstance(group, typer.core.TyperGroup)
    known = {option for one in group.commands["up"].params for option in one.opts}
    assert {word for word in command if word.startswith("--")} <= known
    manager = next(a for a in actions if a.named.get("executable") == "lifecycle_manager")
    assert manager.named["parameters"][0]["node_names"] == ["map_server", "amcl"]
    assert not any(a.named.get("package") == "nav2_amcl" for a in actions)
