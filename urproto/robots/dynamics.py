"""`Dynamics`: torques, accelerations and momenta of an arm with its payload.

Pinocchio computes them if it is installed. It has no wheels for some systems, including native Windows; there,
``urproto.robots.plain_dynamics`` computes the same results in plain Python, more slowly.
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
