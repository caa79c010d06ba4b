"""A world with physics: parts with mass, joints and friction around the arm, in MuJoCo (the extra ``physics``).

`read_physics` reads a scene, `open_cameras` gives access to its pictures. MuJoCo is imported when a scene is built,
and not before.
"""

from emulator.physics.file import SCENE_FILES, open_cameras, read_physics
from emulator.physics.plan import PhysicsPlan

__all__ = ["SCENE_FILES", "PhysicsPlan", "open_cameras", "read_physics"]
