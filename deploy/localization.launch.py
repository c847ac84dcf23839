"""Starts localization for nav2: a map server, and Cluster-MCL in place of AMCL.

ros2 launch localization.launch.py map:=/maps/office.yaml params_file:=nav2_params.yaml
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Return a map server and a lifecycle manager as in nav2_bringup, and `clustermcl up`."""
    params_file = LaunchConfiguration("params_file")
    use_sim_time = LaunchConfiguration("use_sim_time")
    return LaunchDescription(
        [
            DeclareLaunchArgument("map", description="map file (YAML)"),
            DeclareLaunchArgument("params_file", description="nav2_params.yaml, also of AMCL"),
            DeclareLaunchArgument("use_sim_time", default_value="false"),
            DeclareLaunchArgument("clustermcl", default_value="clustermcl", description="program"),
            Node(
                package="nav2_map_server",
                executable="map_server",
                name="map_server",
                output="screen",
                parameters=[
                    params_file,
                    {"yaml_filename": LaunchConfiguration("map"), "use_sim_time": use_sim_time},
                ],
            ),
            ExecuteProcess(
                cmd=[
                    LaunchConfiguration("clustermcl"),
                    "up",
                    "--nav2-params",
                    params_file,
                    "--set",
                    "zenoh.start_router=false",
                ],
                output="screen",
            ),
            Node(
                package="nav2_lifecycle_manager",
                executable="lifecycle_manager",
                name="lifecycle_manager_localization",
                output="screen",
                parameters=[
                    {
                        "use_sim_time": use_sim_time,
                        "autostart": True,
                        "node_names": ["map_server", "amcl"],
                    }
                ],
            ),
        ]
    )
