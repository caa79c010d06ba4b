"""A control loop of your own: a new target every 8 ms, drawn on a circle. Needs `pip install ur-rtde`.

python examples/05_servo_circle.py [HOST]
"""

import math
import sys

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1"
WORK_Q = [0.2, -1.4, 1.5, -1.7, -1.5, 0.1]
PERIOD_S, LOOKAHEAD_S, GAIN = 0.008, 0.1, 300
RADIUS_M, ROUND_S = 0.04, 3.0


def main() -> None:
    receive = RTDEReceiveInterface(HOST)
    control = RTDEControlInterface(HOST, 1 / PERIOD_S)  # its waitPeriod() keeps this time
    control.moveJ(WORK_Q, 2.0, 4.0)
    centre = receive.getActualTCPPose()
    worst = 0.0
    for step in range(round(ROUND_S / PERIOD_S)):
        began = control.initPeriod()
        angle = 2 * math.pi * step * PERIOD_S / ROUND_S
        target = list(centre)
        target[0] += RADIUS_M * (math.cos(angle) - 1)
        target[1] += RADIUS_M * math.sin(angle)
        control.servoL(target, 0.0, 0.0, PERIOD_S, LOOKAHEAD_S, GAIN)
        worst = max(worst, math.dist(target[:3], receive.getActualTCPPose()[:3]))
        control.waitPeriod(began)
    control.servoStop()
    print(f"the tool trailed its target by {worst * 1000:.1f} mm at most")
    control.stopScript()
    control.disconnect()
    receive.disconnect()


if __name__ == "__main__":
    main()
