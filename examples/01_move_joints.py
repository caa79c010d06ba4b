"""Turn joints with ur_rtde and see where the arm stands. Needs `pip install ur-rtde`.

    python examples/01_move_joints.py [HOST]

The arm has to be running: examples/00_first_connection.py does that.
"""

import sys

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1"
WORK_Q = [0.2, -1.4, 1.5, -1.7, -1.5, 0.1]  # rad, base to wrist 3: tool down, elbow bent


def main() -> None:
    receive = RTDEReceiveInterface(HOST)
    control = RTDEControlInterface(HOST)  # sends its control program to the robot and starts it
    for turn in (0.0, 0.4, -0.4, 0.0):
        target = [WORK_Q[0] + turn, *WORK_Q[1:]]
        if not control.moveJ(target, 2.0, 4.0):  # rad/s, rad/s2 of the joint that has furthest to go
            sys.exit("the move was not carried out: is the arm running, and not stopped protectively?")
        q = receive.getActualQ()
        print("joints [rad]", " ".join(f"{angle:7.3f}" for angle in q))
    x, y, z = receive.getActualTCPPose()[:3]
    print(f"tool at x {x:.3f} m, y {y:.3f} m, z {z:.3f} m from the base")
    control.stopScript()
    control.disconnect()
    receive.disconnect()


if __name__ == "__main__":
    main()
