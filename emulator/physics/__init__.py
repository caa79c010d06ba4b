"""A world that moves: parts with mass, joints and friction around the arm, computed by MuJoCo (the extra ``physics``).

`read_physics` is the way in, `open_cameras` the one to its pictures. MuJoCo is imported when a scene is built, and by
nothing before that.
"""

from emulator.physics.file import SCENE_FILES, open_cameras, read_physics
from emulator.physics.plan import PhysicsPlan

__all__ = ["SCENE_FILES", "PhysicsPlan", "open_cameras", "read_physics"]
