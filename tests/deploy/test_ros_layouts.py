import runpy
import sys
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

from clustermcl.ros2.parameter_table import PARAMETERS
from clustermcl.ros2.topics import SENT, Topics
from clustermcl.runtime.settings import Ros2Settings
from clustermcl.runtime.version import VERSION

PACKAGE = Path(__file__).parents[2] / "ros" / "clustermcl_ros"
NAV2_ARGUMENTS = {
    *("namespace", "map", "use_sim_time", "params_file", "autostart", "use_respawn", "log_level")
}
"""Of nav2_bringup's `localization_launch.py`; without those for composition in one process."""
NODE = Topics(Ros2Settings())
OURS = {f"/{topic.name}".replace("/~/", "/amcl/"): topic for topic in (*NODE.read(), *SENT)}


def test_rviz_subscribes_to_what_the_bridge_and_the_robot_publish() -> None:
    manager = yaml.safe_load((PACKAGE / "rviz" / "clustermcl.rviz").read_text())[
        "Visualization Manager"
    ]
    assert manager["Global Options"]["Fixed Frame"] == "map"
    shown = [*manager["Displays"], *(tool for tool in manager["Tools"] if "Topic" in tool)]
    for display in shown:
        topic = OURS[display["Topic"]["Value"]]
        is_latched = display["Topic"]["Durability Policy"] == "Transient Local"
        assert is_latched == topic.qos.latched, "an RViz that starts later gets the last message"
        if topic.qos.best_effort:
            assert display["Topic"]["Reliability Policy"] == "Best Effort"
    assert {display["Topic"]["Value"] for display in shown} >= {"/map", "/scan", "/amcl/hypotheses"}


class Made:
    def __init__(self, *arguments: Any, **named: Any) -> None:
        self.arguments, self.named = arguments, named

    def perform(self, _context: object) -> str:
        return "/robot1/" if self.arguments == ("namespace",) else ""


class Launch(ModuleType):
    """A module of ROS's launch, each of whose classes keeps its arguments."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return type(name, (Made,), {})


def test_the_launch_file_starts_us_in_the_place_of_amcl(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("launch", "launch.actions", "launch.substitutions", "launch_ros.actions")
    for name in (*names, "launch_ros.descriptions", "nav2_common.launch"):
        monkeypatch.setitem(sys.modules, name, Launch(name))
    file = runpy.run_path(str(PACKAGE / "launch" / "localization.launch.py"))
    *declared, nodes = file["generate_launch_description"]().arguments[0]
    assert {one.arguments[0] for one in declared} == NAV2_ARGUMENTS
    assert Path(file["ARGUMENTS"]["params_file"][0]).is_file()
    by_program = {one.named["executable"]: one.named for one in nodes.named["function"](None)}
    assert set(by_program) == {"map_server", "amcl", "lifecycle_manager"}
    ours = by_program["amcl"]
    assert (ours["package"], ours["name"]) == ("clustermcl_ros", "amcl")
    assert by_program["lifecycle_manager"]["parameters"][0]["node_names"] == ["map_server", "amcl"]
    assert all(one["namespace"] == "/robot1" for one in by_program.values())


def test_the_package_names_all_files_and_one_version() -> None:
    manifest = ElementTree.parse(PACKAGE / "package.xml").getroot()
    setup = (PACKAGE / "setup.py").read_text()
    assert manifest.findtext("version") == VERSION
    assert f'version="{VERSION}"' in setup
    for folder in ("launch", "config", "rviz"):
        for file in (PACKAGE / folder).iterdir():
            assert f'"{folder}/{file.name}"' in setup


def test_the_parameters_of_the_package_are_ones_of_the_node() -> None:
    file = yaml.safe_load((PACKAGE / "config" / "amcl.yaml").read_text())
    assert file["amcl"]["ros__parameters"].keys() <= PARAMETERS.keys() | {"engine"}
