"""A robot that is not there: worlds, a wanderer, a lidar; publishes through `sensor_bridge`."""
