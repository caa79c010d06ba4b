"""A servo loop with ur_rtde, after the robot is made ready by its dashboard: python ur_rtde_servo.py HOST STEPS

Prints how long the loop took by the client's clock and by the robot's [s], and how far the arm was behind, in the mean
and at most [rad].
"""

import math
import socket
import sys
import time
from statistics import mean

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HZ = 125.0


def servo(host: str, steps: int) -> None:
    """Sine of 0.1 rad on the base."""
    with socket.create_connection((host, 29999)) as line, line.makefile("rw") as dashboard:
        dashboard.readline()
        for command in ("power on", "brake release", *["robotmode"] * 1000):
            print(command, file=dashboard, flush=True)
            if "RUNNING" in dashboard.readline():
                break
            time.sleep(0.1)
    control, receive = RTDEControlInterface(host, HZ), RTDEReceiveInterface(host, HZ)
    q = receive.getActualQ()
    began, stamp, base, lags = time.monotonic(), receive.getTimestamp(), q[0], []
    for step in range(steps):
        period = control.initPeriod()
        q[0] = base + 0.1 * math.sin(step / 80)
        control.servoJ(q, 0.5, 0.5, 1.0 / HZ, 0.1, 300)
        lags.append(abs(receive.getActualQ()[0] - q[0]))
        control.waitPeriod(period)
    print(
        f"{time.monotonic() - began:.2f} {receive.getTimestamp() - stamp:.2f} {mean(lags):.5f} {max(lags):.4f}",
        flush=True,
    )
    control.servoStop()
    control.stopScript()


if __name__ == "__main__":
    servo(sys.argv[1], int(sys.argv[2]))
