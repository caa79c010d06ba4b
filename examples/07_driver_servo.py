"""The driver of this project: a trajectory of moves, then a wave of its own, a target in every control period.

    python examples/07_driver_servo.py [HOST]

The arm has to be running: examples/00_first_connection.py does that.
"""

import math
import sys

from client.driver import BlockingURDriver, TrajectoryResult, points

HOST = sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1"
WORK_Q = [0.2, -1.4, 1.5, -1.7, -1.5, 0.1]  # rad
AWAY_Q = [0.5, -1.4, 1.5, -1.7, -1.5, 0.1]
SWING_RAD, WAVE_S = 0.1, 2.0
TIMEOUT_S = 0.1  # without a target for so long the robot stops by itself


def main() -> None:
    # Any free ports will do on this side: the program that is sent to the robot is told which.
    ports = {"reverse_port": 0, "sender_port": 0, "trajectory_port": 0, "command_port": 0}
    with BlockingURDriver(HOST, outputs=("actual_q",), **ports) as driver:
        driver.start_program()
        result = driver.execute([points.movej(q, v=1.5, a=4.0) for q in (AWAY_Q, WORK_Q)])
        if result is not TrajectoryResult.SUCCESS:
            sys.exit(f"the trajectory was not executed: {result.name}")

        began, worst, elapsed = driver.next_state()["timestamp"], 0.0, 0.0
        while elapsed < WAVE_S:
            target = list(WORK_Q)
            target[0] += SWING_RAD * (1 - math.cos(2 * math.pi * elapsed / WAVE_S)) / 2
            driver.servoj(target, TIMEOUT_S)
            state = driver.next_state()
            elapsed = state["timestamp"] - began
            worst = max(worst, abs(state["actual_q"][0] - target[0]))
        driver.idle()
    print(f"the first joint trailed its target by {math.degrees(worst):.2f} degrees at most")


if __name__ == "__main__":
    main()
