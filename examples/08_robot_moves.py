"""A robot as a lab script wants it: made ready, moved, watched, and its troubles told.

    python examples/08_robot_moves.py [HOST]

The same program moves a real arm: nothing but the address is another one.
"""

import sys

from client import OutOfReachError, Robot, points

HOST = sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1"
WORK_Q = [0.2, -1.4, 1.5, -1.7, -1.5, 0.1]  # rad, base to wrist 3: tool down, elbow bent
SIDE, LIFT = 0.06, 0.04  # m


def main() -> None:
    with Robot(HOST) as robot:
        robot.make_ready()  # power, brakes, control program: what is still to be done
        robot.move_j(WORK_Q, speed_rad_s=1.5, acceleration_rad_s2=4.0)
        x, y, z, *turn = robot.tcp_pose  # base to TCP, m and a rotation vector in rad

        corners = [[x, y + SIDE, z, *turn], [x, y + SIDE, z + LIFT, *turn], [x, y, z + LIFT, *turn], [x, y, z, *turn]]
        began = robot.state.timestamp_s
        robot.sequence([points.movel(corner, v=0.2, blend_radius_m=0.01) for corner in corners])
        print(f"round the square in {robot.state.timestamp_s - began:.2f} s, without a stop")

        try:
            robot.move_l([x + 5.0, y, z, *turn])
        except OutOfReachError as error:
            print(f"as it should be: {error}")

        robot.move_l([x, y, z + LIFT, *turn], speed_m_s=0.02, wait=False)
        robot.wait_for(lambda state: state.pose_base_tcp[2] > z + LIFT / 4, timeout_s=5.0)
        robot.stop()
        print(f"stopped {(robot.tcp_pose[2] - z) * 1000:.1f} mm up")

        robot.set_digital_out(0, True)
        robot.speed_l([0.0, 0.0, -0.02, 0.0, 0.0, 0.0], duration_s=0.5)  # m/s, rad/s
        robot.set_digital_out(0, False)


if __name__ == "__main__":
    main()
