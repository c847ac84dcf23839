"""Run the bridge to ROS 2."""

from ros2_bridge.process import main

main()
