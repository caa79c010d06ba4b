"""Tasks for robot learning: an emulated robot and its scene as a Gymnasium environment (the extra ``learning``).

Importing this registers the tasks, such as ``ur_emulator/PickAndPlace-v1``, and ``ur_emulator/Task-v1``, whose argument
``task`` is a folder of yours; `RobotEnv` is the base class for tasks of other kinds. Gymnasium 1.0 removed the plug-ins
by which packages registered environments without being imported, so use one of these:

    import emulator.learning
    gymnasium.make("ur_emulator/PickAndPlace-v1")

    gymnasium.make("emulator.learning:ur_emulator/PickAndPlace-v1")
"""

import gymnasium

from emulator.learning.control_modes import CONTROL_MODES
from emulator.learning.environment import RobotEnv
from emulator.learning.goal_env import ENTRY, GoalEnv
from emulator.learning.task_file import TaskError, find_task, read_task

__all__ = ["CONTROL_MODES", "GoalEnv", "RobotEnv", "TaskError"]

for _id, _task in (
    ("Reach", "reach"),
    ("Push", "push"),
    ("PickAndPlace", "pick_and_place"),
    ("PegInHole", "peg_in_hole"),
):
    gymnasium.register(
        f"ur_emulator/{_id}-v1",
        entry_point=ENTRY,
        kwargs={"task": _task},
        max_episode_steps=read_task(find_task(_task)).steps,
    )
gymnasium.register("ur_emulator/Task-v1", entry_point="emulator.learning.goal_env:of_folder")
