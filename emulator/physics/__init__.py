"""A world that moves: parts with mass, joints and friction around the arm, computed by MuJoCo (the extra ``physics``).

`read_physics` is the way in. MuJoCo is imported when a scene is built, and by nothing before that.
"""

from emulator.physics.plan import PhysicsPlan, read_physics

__all__ = ["PhysicsPlan", "read_physics"]
