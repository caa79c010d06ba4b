"""Four goals at full speed, at 30 % and through a protective stop, each recorded and drawn.

python examples/09_thesis.py [robot] [folder] [seconds for each goal]. Turns every joint by up to 2.4 rad.
"""

import asyncio
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from client.controllers import JOINT_NAMES, ErrorCode, JointTrajectory, JointTrajectoryPoint, RobotControl
from client.controllers.goal_files import read_goals
from client.recording import draw, read

HOST = sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1"
FOLDER = Path(sys.argv[2] if len(sys.argv) > 2 else tempfile.mkdtemp(prefix="thesis-"))
SECONDS = float(sys.argv[3]) if len(sys.argv) > 3 else 4.0
CONTROLLER = "scaled_joint_trajectory_controller"
START = JointTrajectoryPoint((0.0, -1.57, 0.0, -1.57, 0.0, 0.0), (0.0,) * 6)
GOALS = [goal.point for goal in read_goals(Path(__file__).with_name("thesis_goals.yaml")).goals]
ALLOWED_RAD = 0.02


def to(point: JointTrajectoryPoint) -> JointTrajectory:
    return JointTrajectory(JOINT_NAMES, (replace(point, time_from_start_s=SECONDS),))


async def drive(goals: list[JointTrajectoryPoint], slider: float, file: Path | None = None, stop: bool = False) -> None:
    async with RobotControl(HOST, make_ready=True, record=file) as control:
        await control.robot.set_speed_slider(slider)
        control.activate(CONTROLLER)
        for point in goals:
            goal = control.manager.controller(CONTROLLER).send_goal(to(point))
            if stop:
                await control.robot.wait_for(lambda _: control.manager.controller(CONTROLLER).progress > 0.5)
                await control.driver.link.send_script("sec stop():\n  protective_stop()\nend")
                await control.robot.wait_for(lambda _: control.driver.protective_stopped)
                await control.robot.recover()  # after 5 s, and for those who know why the arm stopped
            result = await control.result(goal)
            assert result.error_code is ErrorCode.SUCCESSFUL, result
            await control.rest()


def show(file: Path) -> None:
    draw(recording := read(file), file.with_suffix(".png"), file.stem, limit_rad=ALLOWED_RAD)
    deviation = recording.tracking(CONTROLLER).largest_path_deviation
    print(f"{file.with_suffix('.png')}: {recording.time_s[-1]:.1f} s, off the path by {deviation:.4f} rad at most")
    assert deviation < ALLOWED_RAD


RUNS = {"full": (GOALS, 1.0, False), "slow": (GOALS, 0.3, False), "stop": (GOALS[:1], 1.0, True)}
for name, (goals, slider, stop) in RUNS.items():
    asyncio.run(drive([START], 1.0))
    (FOLDER / f"{name}.mcap").unlink(missing_ok=True)
    asyncio.run(drive(goals, slider, FOLDER / f"{name}.mcap", stop))
    show(FOLDER / f"{name}.mcap")
