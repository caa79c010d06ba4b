"""A square in the air without stopping at its corners. Needs `pip install ur-rtde`.

python examples/04_blended_path.py [HOST]
"""

import sys

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1"
WORK_Q = [0.2, -1.4, 1.5, -1.7, -1.5, 0.1]
SPEED, ACCELERATION, BLEND = 0.2, 1.0, 0.02  # m/s, m/s2, m
SIDE = 0.08  # m


def main() -> None:
    receive = RTDEReceiveInterface(HOST)
    control = RTDEControlInterface(HOST)
    control.moveJ(WORK_Q, 2.0, 4.0)
    start = receive.getActualTCPPose()  # x, y, z [m] and a rotation vector [rad]
    path = []
    for y, z in ((SIDE, 0.0), (SIDE, SIDE), (0.0, SIDE), (0.0, 0.0)):
        corner = [start[0], start[1] + y, start[2] + z, *start[3:]]
        path.append([*corner, SPEED, ACCELERATION, BLEND])
    path[-1][-1] = 0.0  # the last one has nothing to blend into
    began = receive.getTimestamp()
    if not control.moveL(path):
        sys.exit("the path was not carried out")
    print(f"round the square in {receive.getTimestamp() - began:.2f} s")
    off = max(abs(now - then) for now, then in zip(receive.getActualTCPPose(), start, strict=True))
    print(f"back at the start to {off * 1000:.3f} mm")
    control.stopScript()
    control.disconnect()
    receive.disconnect()


if __name__ == "__main__":
    main()
