"""``python -I -m robot_simulator --source sim:WORLD``: a simulated robot and its bridge."""

from robot_simulator.process import main

main()
