"""Tasks for robot learning: an emulated robot and its scene as a Gymnasium environment (the extra ``learning``).

Importing this registers ``ur_emulator/PickAndPlace-v0``; `RobotEnv` is the base class for your own tasks. Gymnasium
1.0 removed the plug-ins by which packages registered environments without being imported, so use one of these:

    import emulator.learning
    gymnasium.make("ur_emulator/PickAndPlace-v0")

    gymnasium.make("emulator.learning:ur_emulator/PickAndPlace-v0")
"""

import gymnasium

from emulator.learning.environment import RobotEnv, TaskError
from emulator.learning.pick_and_place import LONGEST, PickAndPlaceEnv

__all__ = ["PickAndPlaceEnv", "RobotEnv", "TaskError"]

gymnasium.register(
    "ur_emulator/PickAndPlace-v0",
    entry_point="emulator.learning.pick_and_place:PickAndPlaceEnv",
    max_episode_steps=LONGEST,
)
