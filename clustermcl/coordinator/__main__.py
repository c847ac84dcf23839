"""``python -I -m clustermcl.coordinator --settings FILE``: the coordinator process of one robot."""

from clustermcl.coordinator.process import main

main()
