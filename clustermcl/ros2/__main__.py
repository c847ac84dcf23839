"""Run the bridge to ROS 2."""

from clustermcl.ros2.process import main

main()
