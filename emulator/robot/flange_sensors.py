"""Force/torque sensor and accelerometer, which are both in the flange and share its axes."""

from emulator.on_demand import on_demand
from emulator.robot.installation import Payload
from emulator.robot.tool import ToolMotion, ToolState
from urproto.vectors import ZERO6, Matrix3, Vector3, Vector6, add3, cross, rotate, rotate_back, sub3


class FlangeSensors:
    """Readings in one control period, computed when they are read.

    payload: the true one. gravity: as in set_gravity, with the acceleration of the base [m/s2]. wrench: external, at
    the TCP, in base axes [N, Nm]; tcp_force: the same as the controller knows it, zeroed. in_flange: whether the
    controller reports it about the flange, as e-Series with their own sensor do.
    """

    def __init__(
        self, tool: ToolMotion, payload: Payload, gravity: Vector3, wrench: Vector6 = ZERO6, in_flange: bool = False
    ) -> None:
        self._tool, self._payload, self._gravity = tool, payload, gravity
        self._wrench, self._in_flange = wrench, in_flange
        self.tcp_force: Vector6 = ZERO6

    @on_demand
    def acceleration(self) -> Vector3:
        """The accelerometer's reading [m/s2]."""
        return rotate_back(self._tool.now.flange_axes, add3(self._tool.acceleration, self._gravity))

    @on_demand
    def force(self) -> Vector6:
        """The external wrench as the controller reports it, in base axes."""
        force, now = self.tcp_force, self._tool.now
        if not self._in_flange or force == ZERO6 or now.tcp_offset == ZERO6:
            return force
        torque = add3(force[3:], cross(sub3(now.pose, now.flange_pose), force))
        return (force[0], force[1], force[2], *torque)

    @on_demand
    def raw_wrench(self) -> Vector6:
        """The sensor's own reading, with the payload's weight, in the flange's axes."""
        if self._wrench == ZERO6 and not self._payload.mass:
            return ZERO6
        now = self._tool.now
        axes, weight = now.flange_axes, weight_of(self._payload, now.flange_axes, self._gravity)
        force = rotate_back(axes, self._wrench)
        lever = rotate_back(axes, sub3(now.pose, now.flange_pose))
        torque = add3(rotate_back(axes, self._wrench[3:]), add3(cross(lever, force), cross(self._payload.cog, weight)))
        return (*add3(force, weight), *torque)


def weight_of(payload: Payload, axes: Matrix3, gravity: Vector3) -> Vector3:
    """Weight of a payload in the flange's axes [N]."""
    return rotate_back(axes, (-payload.mass * gravity[0], -payload.mass * gravity[1], -payload.mass * gravity[2]))


def weight_difference(now: ToolState, mounted: Payload, known: Payload, gravity: Vector3) -> Vector6:
    """Weight of the mounted payload minus that of the known one, as a wrench at the TCP in base axes [N, Nm]."""
    axes = now.flange_axes
    true, assumed = weight_of(mounted, axes, gravity), weight_of(known, axes, gravity)
    lever = rotate_back(axes, sub3(now.flange_pose, now.pose))
    torque = sub3(cross(add3(lever, mounted.cog), true), cross(add3(lever, known.cog), assumed))
    return (*rotate(axes, sub3(true, assumed)), *rotate(axes, torque))
