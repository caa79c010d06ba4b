"""A peg into a hole that is 3 mm beside where it should be: force mode presses, and drags it along a spiral.

With ur_rtde and nothing else: see peg.yaml.
"""

import sys
from math import cos, pi, sin

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

PEG_M = 0.08
TOP_M = 0.14  # of the block
HOLE = (-0.397, -0.302)  # where the program believes it is
PRESS_N = 15.0
INSERTED_M = 0.02
DRAG_N = 8.0  # more than friction holds: the peg moves at its limit of speed
SPEED, PITCH_M = 0.01, 0.0006
LIMITS = [SPEED, SPEED, 0.05, 0.5, 0.5, 0.5]
GIVE_UP_S = 40.0


def main(host: str) -> None:
    """Insert the peg."""
    receive, control = RTDEReceiveInterface(host), RTDEControlInterface(host)
    control.setTcp([0, 0, PEG_M, 0, 0, 0])
    control.setPayload(0.15, [0, 0, PEG_M / 2])
    try:
        x, y, _, *turn = receive.getActualTCPPose()
        control.moveL([x, y, TOP_M + 0.05, *turn], 0.3, 1.0)
        control.moveL([*HOLE, TOP_M + 0.01, 0, pi, 0], 0.3, 1.0)
        control.zeroFtSensor()
        start = before = receive.getTimestamp()
        angle = 0.0
        while (height := receive.getActualTCPPose()[2]) > TOP_M - INSERTED_M:
            now = receive.getTimestamp()
            if now - start > GIVE_UP_S:
                sys.exit(f"the hole was not found: the peg stands at {height:.4f} m")
            radius = PITCH_M * (1.0 + angle / (2.0 * pi))
            angle, before = angle + SPEED * (now - before) / radius, now
            wrench = [DRAG_N * cos(angle), DRAG_N * sin(angle), -PRESS_N, 0, 0, 0]
            control.forceMode([0.0] * 6, [1, 1, 1, 0, 0, 0], wrench, 2, LIMITS)
        control.forceModeStop()
        x, y, *_ = receive.getActualTCPPose()
        print(
            f"the hole is at {x:.4f}, {y:.4f}, {1000 * ((x - HOLE[0]) ** 2 + (y - HOLE[1]) ** 2) ** 0.5:.1f} mm aside"
        )
    finally:
        control.stopScript()
        for interface in (control, receive):
            interface.disconnect()


if __name__ == "__main__":
    main(sys.argv[1])
