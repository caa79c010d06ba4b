"""The four goals of the thesis by ROS 2: from `ur-client ros2`, or any driver with these names, to the arm.

python examples/ros2_thesis.py [seconds for each goal]. Turns every joint by up to 2.4 rad.
"""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.action import ActionClient

from client.controllers import JOINT_NAMES
from client.controllers.goal_files import read_goals
from client.ros2 import message_packages

message_packages.ensure()  # control_msgs, where no workspace has it

from control_msgs.action import FollowJointTrajectory  # noqa: E402
from control_msgs.msg import JointTrajectoryControllerState  # noqa: E402
from trajectory_msgs.msg import JointTrajectoryPoint  # noqa: E402

SECONDS = float(sys.argv[1]) if len(sys.argv) > 1 else 4.0
CONTROLLER = "/scaled_joint_trajectory_controller"
START = (0.0, -1.57, 0.0, -1.57, 0.0, 0.0)
GOALS = [goal.point.positions for goal in read_goals(Path(__file__).with_name("thesis_goals.yaml")).goals]
PATIENCE_S = 60.0

rclpy.init()
node = rclpy.create_node("thesis")
lags = []  # rad: of the joint that lags most, every cycle
node.create_subscription(
    JointTrajectoryControllerState,
    f"{CONTROLLER}/controller_state",
    lambda state: lags.append(max(map(abs, state.error.positions), default=0.0)),
    10,
)
client = ActionClient(node, FollowJointTrajectory, f"{CONTROLLER}/follow_joint_trajectory")
if not client.wait_for_server(PATIENCE_S):
    sys.exit("no driver in this domain: is ur-client ros2 running?")


def answered(future: Any) -> Any:
    rclpy.spin_until_future_complete(node, future)
    return future.result()


def send(positions: Sequence[float]) -> None:
    point = JointTrajectoryPoint(positions=positions, velocities=[0.0] * 6)
    point.time_from_start.sec, point.time_from_start.nanosec = divmod(round(SECONDS * 1e9), 10**9)
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = list(JOINT_NAMES)
    goal.trajectory.points = [point]
    until_s = time.monotonic() + PATIENCE_S
    while not (handle := answered(client.send_goal_async(goal))).accepted:
        if time.monotonic() > until_s:
            sys.exit("the goal is refused: the driver's log says why")
        time.sleep(0.5)  # the arm is being made ready
    result = answered(handle.get_result_async()).result
    assert result.error_code == FollowJointTrajectory.Result.SUCCESSFUL, result.error_string


send(START)
lags.clear()
for number, positions in enumerate(GOALS, 1):
    send(positions)
    print(f"goal {number} of {len(GOALS)} is reached")
print(f"{len(lags)} states of the controller, a joint behind by {max(lags):.3f} rad at most")
rclpy.shutdown()
