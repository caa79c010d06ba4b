"""Moves the robot at an address with ur_rtde and says where it is."""

import sys

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

GOAL_RAD = [0.3, -1.2, 1.0, -1.4, -1.57, 0.0]

receive = RTDEReceiveInterface(sys.argv[1])
control = RTDEControlInterface(sys.argv[1])
control.moveJ(GOAL_RAD, 2.0, 3.0)
reached = receive.getActualQ()
control.stopScript()
control.disconnect()
receive.disconnect()
print("reached", [round(q, 3) for q in reached])
if max(abs(q - wanted) for q, wanted in zip(reached, GOAL_RAD, strict=True)) > 0.001:
    sys.exit("that is not where it was to go")
