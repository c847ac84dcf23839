"""Localization for nav2, with the arguments of nav2_bringup's `localization_launch.py`.

ros2 launch clustermcl_ros localization.launch.py map:=office.yaml params_file:=nav2_params.yaml
"""

from pathlib import Path
from typing import Any

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.descriptions import ParameterFile
from nav2_common.launch import RewrittenYaml

CONFIG = Path(__file__).resolve().parents[1] / "config" / "amcl.yaml"
ARGUMENTS = {
    "namespace": ("", "namespace of all nodes"),
    "map": ("", "map file (YAML)"),
    "use_sim_time": ("false", "take the time from /clock"),
    "params_file": (str(CONFIG), "nav2_params.yaml, also one for AMCL"),
    "autostart": ("true", "the lifecycle manager activates the nodes"),
    "use_respawn": ("false", "start a node again that has ended"),
    "log_level": ("info", "log level of the nodes"),
}


def nodes(context: Any) -> list[Any]:
    """Return nav2's map server and lifecycle manager, and our node in place of AMCL."""
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    namespace = given["namespace"].perform(context).strip("/")
    file = RewrittenYaml(
        source_file=given["params_file"],
        root_key=namespace,
        param_rewrites={"use_sim_time": given["use_sim_time"], "yaml_filename": given["map"]},
        convert_types=True,
    )
    use_sim_time = {"use_sim_time": given["use_sim_time"]}
    parameters = [ParameterFile(file, allow_substs=True), use_sim_time]
    common = {
        # Absolute: a launch file that includes this one may have pushed the namespace.
        "namespace": f"/{namespace}",
        "output": "screen",
        "arguments": ["--ros-args", "--log-level", given["log_level"]],
    }
    localizing = common | {
        "respawn": given["use_respawn"],
        "respawn_delay": 2.0,
        "remappings": [("/tf", "tf"), ("/tf_static", "tf_static")],
    }
    managed = {"autostart": given["autostart"], "node_names": ["map_server", "amcl"]}
    return [
        Node(
            package="nav2_map_server",
            executable="map_server",
            name="map_server",
            parameters=[*parameters, {"yaml_filename": given["map"]}],
            **localizing,
        ),
        Node(
            package="clustermcl_ros",
            executable="amcl",
            name="amcl",
            parameters=parameters,
            **localizing,
        ),
        Node(
            package="nav2_lifecycle_manager",
            executable="lifecycle_manager",
            name="lifecycle_manager_localization",
            parameters=[managed | use_sim_time],
            **common,
        ),
    ]


def generate_launch_description() -> LaunchDescription:
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])
