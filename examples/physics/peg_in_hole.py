"""A peg into a hole that is 1.5 mm beside where it should be: force mode presses it down, and drags it along a spiral.

With ur_rtde and nothing else: see peg.yaml.
"""

import sys
from collections.abc import Iterator
from math import cos, hypot, pi, sin

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

PEG_M = 0.08
TOP_M = 0.14  # of the block
HOLE = (-0.3988, -0.3009)  # where the program believes it is
PRESS_N = 15.0
INSERTED_M = 0.02
DRAG_N = 8.0  # more than friction holds
PITCH_M, TURNS, CORNERS, NEAR_M, PATIENCE_S = 0.0006, 6, 12, 0.0002, 0.5
LIMITS = [0.004, 0.004, 0.05, 0.5, 0.5, 0.5]  # slow, since it goes on while nobody looks


def spiral() -> Iterator[tuple[float, float]]:
    """Points around where the hole should be."""
    for step in range(TURNS * CORNERS):
        angle, radius = 2.0 * pi * step / CORNERS, PITCH_M * step / CORNERS
        yield HOLE[0] + radius * cos(angle), HOLE[1] + radius * sin(angle)


def drag(receive: RTDEReceiveInterface, control: RTDEControlInterface, x: float, y: float) -> None:
    """Press, and go to a point; where something holds it, not for long."""
    end = receive.getTimestamp() + PATIENCE_S
    while receive.getTimestamp() < end:
        pose = receive.getActualTCPPose()
        ahead = x - pose[0], y - pose[1]
        if hypot(*ahead) < NEAR_M or pose[2] < TOP_M - INSERTED_M:
            return
        push = [DRAG_N * part / hypot(*ahead) for part in ahead]
        control.forceMode([0.0] * 6, [1, 1, 1, 0, 0, 0], [*push, -PRESS_N, 0, 0, 0], 2, LIMITS)


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
        for x, y in spiral():
            drag(receive, control, x, y)
            if receive.getActualTCPPose()[2] < TOP_M - INSERTED_M:
                break
        else:
            sys.exit("the hole was not found")
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
