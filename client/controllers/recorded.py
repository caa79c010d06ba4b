"""What a robot with controllers does, into a file: its states and those of its trajectory controllers."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from client.controllers.joint_trajectory import JointTrajectoryController
from client.controllers.manager import ControllerManager
from client.driver import URDriver
from client.recording import DEFAULT_FIELDS, BackgroundRecorder

__all__ = ["DEFAULT_FIELDS", "listen", "recorded"]

_WITH_CONTROLLERS = ".mcap"  # other formats have no place for their states


@asynccontextmanager
async def recorded(driver: URDriver, path: Path) -> AsyncIterator[BackgroundRecorder]:
    """Record the robot's states while the context lasts; the driver receives `DEFAULT_FIELDS`.

    A process of its own writes, so that the control loop is not late. Raises RecordingError.
    """
    info = {"robot": driver.config.robot, "polyscope": str(driver.version)}
    recorder = await asyncio.to_thread(BackgroundRecorder, path, DEFAULT_FIELDS, info)
    driver.robot.on_state.append(recorder.write)
    try:
        yield recorder
    finally:
        driver.robot.on_state.remove(recorder.write)
        await asyncio.to_thread(recorder.close)


def listen(recorder: BackgroundRecorder, manager: ControllerManager) -> None:
    """Record the states of the trajectory controllers, too, that are loaded from now on."""

    def begin(controller: object) -> None:
        if isinstance(controller, JointTrajectoryController):
            name = controller.name
            controller.state_topic.subscribe(lambda state: recorder.write_controller(name, state))

    if recorder.path.suffix.lower() == _WITH_CONTROLLERS:
        manager.on_load.append(begin)
