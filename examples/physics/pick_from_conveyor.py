"""Parts from a conveyor into rows on the table, with ur_rtde and nothing else: see conveyor.yaml.

The number of parts may follow the robot's address.
"""

import sys
from math import pi

from rtde_control import RTDEControlInterface
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface

GRIP, BELT = 0, 2  # outputs
AT_END, HOLDING = 0, 1  # inputs
DOWN = (0.0, pi, 0.0)
PICK = (-0.45, -0.235)
WAIT_S = 15.0  # of the robot's time


def until(receive: RTDEReceiveInterface, number: int, level: bool = True, within_s: float = WAIT_S) -> bool:
    """Wait for a digital input; False when it does not come."""
    end = receive.getTimestamp() + within_s
    while bool(receive.getActualDigitalInputBits() >> number & 1) is not level:
        if receive.getTimestamp() > end:
            return False
    return True


def main(host: str, count: int = 10) -> None:
    """Move so many parts."""
    receive, io, control = RTDEReceiveInterface(host), RTDEIOInterface(host), RTDEControlInterface(host)
    control.setTcp([0, 0, 0.11, 0, 0, 0])
    control.setPayload(0.5, [0, 0, 0.035])
    try:
        for number in range(count):
            control.moveL([*PICK, 0.2, *DOWN], 1.0, 2.0)
            io.setStandardDigitalOut(BELT, True)
            if not until(receive, AT_END):
                sys.exit("no part came")
            io.setStandardDigitalOut(BELT, False)
            control.moveL([*PICK, 0.112, *DOWN], 0.5, 2.0)
            io.setStandardDigitalOut(GRIP, True)
            if not until(receive, HOLDING):
                sys.exit(f"part {number} was not there to grip")
            control.moveL([*PICK, 0.2, *DOWN], 1.0, 2.0)
            x, y = -0.25 + 0.08 * (number % 5), -0.55 - 0.08 * (number // 5)
            control.moveJ_IK([x, y, 0.1, *DOWN], 2.0, 4.0)
            control.moveL([x, y, 0.016, *DOWN], 0.5, 2.0)
            held = until(receive, HOLDING, within_s=0.1)
            io.setStandardDigitalOut(GRIP, False)
            until(receive, HOLDING, level=False)
            control.moveL([x, y, 0.1, *DOWN], 1.0, 2.0)
            print(f"part {number} {'is on the table' if held else 'was lost on the way'}")
    finally:
        control.stopScript()
        for interface in (control, io, receive):
            interface.disconnect()


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
