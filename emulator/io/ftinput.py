"""An external force/torque sensor whose values come in over RTDE."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from emulator.snapshot import Vector3, Vector6
from urproto.robots.pose import rotvec_to_matrix

if TYPE_CHECKING:
    from emulator.robot.arm import Arm

__all__ = ["ForceInput"]

_ZERO6: Final[Vector6] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass
class ForceInput:
    """What ``ft_rtde_input_enable`` sets and the RTDE input external_force_torque feeds.

    wrench_flange: measured, in the flange's axes, at ``measuring_offset`` from the flange
    [N, Nm, m] (that the axes are the flange's is a guess). sensor_mass and sensor_cog: the
    sensor's own weight [kg, m], kept for programs to read; its readings are taken as
    already free of it.
    """

    enabled: bool = False
    wrench_flange: Vector6 = _ZERO6
    sensor_mass: float = 0.0
    measuring_offset: Vector3 = (0.0, 0.0, 0.0)
    sensor_cog: Vector3 = (0.0, 0.0, 0.0)

    def wrench_base(self, arm: "Arm") -> Vector6:
        """The wrench in the base frame, at the TCP the arm had in the last period."""
        if self.wrench_flange == _ZERO6:
            return _ZERO6
        flange = arm.flange_pose
        m = rotvec_to_matrix(*flange[3:])
        force = _rotate(m, *self.wrench_flange[:3])
        tx, ty, tz = _rotate(m, *self.wrench_flange[3:])
        ox, oy, oz = _rotate(m, *self.measuring_offset)
        x, y, z = (f + o - t for f, o, t in zip(flange, (ox, oy, oz), arm.tcp_pose, strict=False))
        fx, fy, fz = force
        return (fx, fy, fz, tx + y * fz - z * fy, ty + z * fx - x * fz, tz + x * fy - y * fx)


def _rotate(m: tuple[float, ...], x: float, y: float, z: float) -> Vector3:
    return (
        m[0] * x + m[1] * y + m[2] * z,
        m[3] * x + m[4] * y + m[5] * z,
        m[6] * x + m[7] * y + m[8] * z,
    )
