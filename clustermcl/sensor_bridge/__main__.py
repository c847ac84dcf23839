"""``python -I -m clustermcl.sensor_bridge --settings FILE``: the sensor bridge of one robot."""

from clustermcl.sensor_bridge.process import main

main()
