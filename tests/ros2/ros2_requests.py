"""What the tests of the ROS 2 driver do again and again, and names that they share."""

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from driver_rig import HOME
from ros2_rig import PATIENCE_S, SCALED, Lab

from client.ros2.host import interface_if_any
from urproto.compat_asyncio import timeout
from urproto.joints import JOINT_NAMES

FOLLOW = "control_msgs/action/FollowJointTrajectory"
SWITCH = "controller_manager_msgs/srv/SwitchController"
LIST = "controller_manager_msgs/srv/ListControllers"
TRIGGER = "std_srvs/srv/Trigger"
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
BEST_EFFORT, STRICT = 1, 2
_MOVING = ("joint_trajectory_controller", SCALED, "forward_position_controller", "forward_velocity_controller",
           "passthrough_trajectory_controller", "freedrive_mode_controller", "force_mode_controller",
           "tool_contact_controller", "motion_primitive_forward_controller")  # fmt: skip


def needs(kind: str) -> None:
    """Skips a test of an interface that the distribution does not have; for use once a lab is there."""
    if interface_if_any(kind) is None:
        pytest.skip(f"this distribution has no {kind}")


def mentions(answer: dict[str, Any], words: str) -> bool:
    """Whether an answer has these words as its message. In Humble it has none."""
    return words in answer.get("message", words).replace("\n", " ")


def q(lab: Lab) -> tuple[float, ...]:
    return tuple(lab.robot.controller.snapshot.actual_q)


async def only(lab: Lab, *names: str) -> None:
    stop = [name for name in _MOVING if name not in names]
    answer = await lab.peer.call(
        "/controller_manager/switch_controller",
        SWITCH,
        activate_controllers=list(names),
        deactivate_controllers=stop,
        strictness=BEST_EFFORT,
    )
    assert answer["ok"], answer


def shifted(offset: float, joint: int = 5) -> list[float]:
    return [angle + (offset if place == joint else 0.0) for place, angle in enumerate(HOME)]


def trajectory(*points: tuple[list[float] | tuple[float, ...], float], names: Any = JOINT_NAMES) -> dict[str, Any]:
    def duration(seconds: float) -> dict[str, int]:
        return {"sec": int(seconds // 1), "nanosec": round(seconds % 1 * 1e9)}

    return {
        "joint_names": list(names),
        "points": [
            {"positions": list(positions), "velocities": [0.0] * len(positions), "time_from_start": duration(seconds)}
            for positions, seconds in points
        ],
    }


async def begin(lab: Lab, controller: str, target: Any, seconds: float, **more: Any) -> bool:
    goal = {"trajectory": trajectory((target, seconds)), **more}
    answer = await lab.peer.request(goal=f"/{controller}/follow_joint_trajectory", type=FOLLOW, request=goal)
    return bool(answer["accepted"])


async def result(lab: Lab, controller: str) -> dict[str, Any]:
    return await lab.peer.request(result=f"/{controller}/follow_joint_trajectory")


async def follow(lab: Lab, controller: str, target: Any, seconds: float) -> dict[str, Any]:
    assert await begin(lab, controller, target, seconds)
    return await result(lab, controller)


async def states(lab: Lab) -> dict[str, str]:
    answer = await lab.peer.call("/controller_manager/list_controllers", LIST)
    return {one["name"]: one["state"] for one in answer["controller"]}


async def settled(condition: Callable[[], bool]) -> None:
    async with timeout(PATIENCE_S):
        while not condition():
            await asyncio.sleep(0.01)


async def until(lab: Lab, met: Callable[[dict[str, str]], bool]) -> None:
    async with timeout(60.0):
        while not met(await states(lab)):
            pass
