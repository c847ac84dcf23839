"""A robot that is not there: worlds, a wandering robot, a lidar; publishes through `sensor_bridge`."""
