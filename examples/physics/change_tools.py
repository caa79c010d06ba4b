"""A plate carried with one tool, and its place found with another, with ur_rtde and nothing else: see tools.yaml."""

import sys
from math import pi

from rtde_control import RTDEControlInterface
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface

SUCK, LOCK = 0, 4  # outputs
VACUUM, LOCKED = 1, 5  # inputs
FACE_M = 0.05  # of the changer, from the flange
DOWN = (0.0, pi, 0.0)
CUP, PROBE = (-0.5, 0.0, 0.2305), (-0.5, -0.2, 0.2305)  # where the changer's face is when it takes them
CUP_M, PROBE_M = 0.115, 0.03  # from the face to the lip, and to the lower side
FROM, TO = (-0.3, -0.4), (-0.1, -0.5)
WAIT_S = 2.0  # of the robot's time


class Arm:
    """A robot with a tool changer."""

    def __init__(self, host: str) -> None:
        self.receive, self.io = RTDEReceiveInterface(host), RTDEIOInterface(host)
        self.control = RTDEControlInterface(host)
        self.carry(0.0, 0.0)

    def carry(self, tool_m: float, kg: float) -> None:
        """What the controller should know of a tool; zeros for none."""
        self.control.setTcp([0, 0, FACE_M + tool_m, 0, 0, 0])
        self.control.setPayload(kg, [0, 0, FACE_M + 0.015])

    def until(self, number: int, level: bool = True) -> None:
        """Wait for a digital input."""
        end = self.receive.getTimestamp() + WAIT_S
        while bool(self.receive.getActualDigitalInputBits() >> number & 1) is not level:
            if self.receive.getTimestamp() > end:
                sys.exit(f"input {number} did not become {level}")

    def go(self, x: float, y: float, z: float, speed: float = 0.5) -> None:
        """Pointing down, in a straight line."""
        self.control.moveL([x, y, z, *DOWN], speed, 2.0)

    def take(self, place: tuple[float, float, float], tool_m: float, kg: float) -> None:
        """A tool from its place."""
        x, y, z = place
        self.go(x, y, z + 0.1)
        self.go(x, y, z, 0.1)
        self.io.setStandardDigitalOut(LOCK, True)
        self.until(LOCKED)
        self.carry(tool_m, kg)
        self.go(x, y, z - tool_m + 0.15)

    def put_back(self, place: tuple[float, float, float]) -> None:
        """The tool that it has."""
        x, y, z = place
        self.carry(0.0, 0.0)
        self.go(x, y, z + 0.15)
        self.go(x, y, z, 0.1)
        self.io.setStandardDigitalOut(LOCK, False)
        self.until(LOCKED, level=False)
        self.go(x, y, z + 0.1)

    def close(self) -> None:
        """Leave the robot."""
        self.control.stopScript()
        for interface in (self.control, self.io, self.receive):
            interface.disconnect()


def main(host: str) -> None:
    """Carry the plate by the cup, then touch it with the probe."""
    arm = Arm(host)
    try:
        arm.take(CUP, CUP_M, 0.6)
        arm.go(*FROM, 0.15)
        arm.go(*FROM, 0.0205, 0.1)
        arm.io.setStandardDigitalOut(SUCK, True)
        arm.until(VACUUM)
        arm.go(*FROM, 0.15)
        arm.go(*TO, 0.15)
        arm.go(*TO, 0.021, 0.1)
        arm.io.setStandardDigitalOut(SUCK, False)
        arm.until(VACUUM, level=False)
        arm.go(*TO, 0.15)
        arm.put_back(CUP)
        arm.take(PROBE, PROBE_M, 0.3)
        arm.go(*TO, 0.1)
        if not arm.control.moveUntilContact([0, 0, -0.02, 0, 0, 0]):
            sys.exit("the probe touched nothing")
        print(f"the plate's upper side is at z = {arm.receive.getActualTCPPose()[2]:.4f} m")
        arm.go(*TO, 0.1)
        arm.put_back(PROBE)
    finally:
        arm.close()


if __name__ == "__main__":
    main(sys.argv[1])
