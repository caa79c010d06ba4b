"""Where a wall is, by touching it: with ur_rtde and nothing else, see wall.yaml."""

import sys
from math import pi

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

FINGER_M, RADIUS_M = 0.15, 0.01


def main(host: str) -> None:
    """Find it, at the height of the box, which is pushed along, and above it."""
    receive, control = RTDEReceiveInterface(host), RTDEControlInterface(host)
    control.setTcp([0, 0, FINGER_M, 0, 0, 0])
    control.setPayload(0.05, [0, 0, FINGER_M])
    try:
        for height in (0.03, 0.1):
            control.moveL([-0.35, -0.2, height, 0, pi, 0], 0.3, 1.0)
            control.zeroFtSensor()
            control.moveUntilContact([-0.05, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0])
            x = receive.getActualTCPPose()[0] - RADIUS_M
            print(f"the wall is at x = {x:.4f} m, {height} m above the table")
            control.moveL([-0.35, -0.2, height, 0, pi, 0], 0.3, 1.0)
    finally:
        control.stopScript()
        for interface in (control, receive):
            interface.disconnect()


if __name__ == "__main__":
    main(sys.argv[1])
