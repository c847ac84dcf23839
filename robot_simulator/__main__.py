"""``python -I -m robot_simulator --set bridge.source=sim:WORLD``: a simulated robot."""

from robot_simulator.process import main

main()
