"""``python -I -m clustermcl.simulator --set bridge.source=sim:WORLD``: a simulated robot."""

from clustermcl.simulator.process import main

main()
