"""``python -I -m coordinator --settings FILE``: the coordinator process of one robot."""

from coordinator.process import main

main()
