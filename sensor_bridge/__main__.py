"""``python -I -m sensor_bridge --settings FILE``: the sensor bridge of one robot."""

from sensor_bridge.process import main

main()
