"""What sits between a joint's motor and its link: friction and the rotor behind the gear, one row a size of joint.

The maker publishes neither. The rows of 330, 150 and 56 Nm are of the size that a public identification of a UR10
found (least squares on joint torques: viscous 21.3, 20.2, 10.4, 3.6, 2.5, 3.0 Nm s/rad; Coulomb 12.5, 13.3, 5.0, 2.0,
2.7, 2.3 Nm; drive inertia 3.7 kg m2 at the shoulder lift, 0.07 to 0.44 kg m2 at the wrists). The others, and the rotor
of 150 Nm, are guesses in proportion to the torque limit.
"""

from dataclasses import dataclass
from math import log
from typing import Final

from urproto.robots.model import RobotModel


@dataclass(frozen=True, slots=True)
class JointSize:
    """Everything at the joint's side of the gear (101:1). Friction is viscous * speed + Coulomb * sign(speed)."""

    torque_max_Nm: float  # of the joints this row stands for
    coulomb_Nm: float
    viscous_Nm_s: float  # per rad
    rotor_kg_m2: float  # the rotor's inertia times the gear ratio squared


SIZES: Final = (
    JointSize(10.0, 0.6, 0.5, 0.04),
    JointSize(28.0, 1.2, 1.5, 0.12),
    JointSize(56.0, 2.3, 3.0, 0.25),
    JointSize(70.0, 2.9, 3.7, 0.35),
    JointSize(107.0, 4.4, 5.5, 0.6),
    JointSize(150.0, 5.0, 10.4, 1.3),
    JointSize(204.0, 7.0, 13.0, 1.9),
    JointSize(330.0, 13.0, 20.7, 3.7),
    JointSize(433.0, 17.0, 25.0, 5.5),
    JointSize(738.0, 29.0, 40.0, 12.0),
)


def joint_sizes(model: RobotModel) -> tuple[JointSize, ...]:
    """The row of each joint, base to wrist 3: the one whose torque limit is nearest in ratio."""
    return tuple(
        min(SIZES, key=lambda size: abs(log(size.torque_max_Nm / torque_max))) for torque_max in model.torque_max
    )
