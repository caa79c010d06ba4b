"""`Dynamics`: torques, accelerations and momenta of an arm with its payload.

Pinocchio computes them where it is installed. It has no wheels for some systems, native Windows among them: there
``urproto.robots.plain_dynamics`` gives the same numbers in plain Python, in more time.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from urproto.robots.pinocchio_dynamics import Dynamics
else:
    try:
        from urproto.robots.pinocchio_dynamics import Dynamics
    except ModuleNotFoundError as missing:
        if missing.name != "pinocchio":
            raise
        from urproto.robots.plain_dynamics import PlainDynamics as Dynamics

__all__ = ["Dynamics"]
