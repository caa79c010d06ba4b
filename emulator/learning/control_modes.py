"""What the numbers of an action mean: speeds or positions, of the tool or of the joints.

Each has a pass of the program's loop, in URScript, and the register values for an action. The program keeps the tool's
orientation in the modes of the tool.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Protocol

from emulator.learning.environment import FIRST_REGISTER
from urproto.robots import RobotModel
from urproto.vectors import Vector3

if TYPE_CHECKING:
    from emulator.snapshot import Snapshot

_FASTEST_M_S: Final = 0.25  # along each axis; small arms, for which everything is nearer, are slower
_FASTEST_REACH_PER_S: Final = 0.3
_JOINT_RAD_S: Final = 1.0
_BRAKING_S: Final = 0.2  # the speed towards a side of the workspace is limited to the remaining distance in this time
_REGISTERS: Final = "[" + ", ".join(f"read_input_float_register({FIRST_REGISTER + i})" for i in range(6)) + "]"
_FOLLOWED: Final = "t={step_s}, lookahead_time=0.1, gain=300"

Bounds = tuple[list[float], list[float]]


class ControlMode(Protocol):
    """A kind of action. script: a pass of the program's loop; bounds: of the action, without a gripper's."""

    script: str
    bounds: Bounds

    def begin(self, state: "Snapshot") -> Sequence[float]:
        """The registers with which the arm stays where it is."""

    def registers(self, action: Sequence[float], state: "Snapshot", step_s: float) -> Sequence[float]:
        """The registers for an action."""


class TcpVelocity:
    """Speeds of the tool along x, y, z of the base frame; 1 is 0.25 m/s, of a UR3 0.15 m/s."""

    script = f"speedl({_REGISTERS}, 2.0, {{step_s}})"

    def __init__(self, model: RobotModel, workspace: tuple[Vector3, Vector3]) -> None:
        self.bounds: Bounds = ([-1.0] * 3, [1.0] * 3)
        self._workspace, self._fastest = workspace, _fastest_m_s(model)

    def begin(self, state: "Snapshot") -> Sequence[float]:
        return [0.0] * 6

    def registers(self, action: Sequence[float], state: "Snapshot", step_s: float) -> Sequence[float]:
        low, high = self._workspace
        speeds = [
            _within((least - at) / _BRAKING_S, self._fastest * _within(-1.0, share, 1.0), (most - at) / _BRAKING_S)
            for share, at, least, most in zip(action, state.actual_TCP_pose[:3], low, high, strict=True)
        ]
        return [*speeds, 0.0, 0.0, 0.0]


class JointVelocity:
    """Speeds of the joints; 1 is 1 rad/s."""

    script = f"speedj({_REGISTERS}, 4.0, {{step_s}})"

    def __init__(self, model: RobotModel, workspace: tuple[Vector3, Vector3]) -> None:
        self.bounds: Bounds = ([-1.0] * 6, [1.0] * 6)

    def begin(self, state: "Snapshot") -> Sequence[float]:
        return [0.0] * 6

    def registers(self, action: Sequence[float], state: "Snapshot", step_s: float) -> Sequence[float]:
        return [_JOINT_RAD_S * _within(-1.0, share, 1.0) for share in action]


class TcpPosition:
    """Positions of the TCP within the workspace, base frame [m], approached at 0.25 m/s, by a UR3 at 0.15 m/s."""

    script = (
        f"registers = {_REGISTERS}\n    servoj(get_inverse_kin(p[registers[0], registers[1], registers[2], "
        f"registers[3], registers[4], registers[5]]), {_FOLLOWED})"
    )

    def __init__(self, model: RobotModel, workspace: tuple[Vector3, Vector3]) -> None:
        low, high = workspace
        self.bounds: Bounds = ([*low], [*high])
        self._fastest = _fastest_m_s(model)
        self._setpoint: list[float] = []

    def begin(self, state: "Snapshot") -> Sequence[float]:
        self._setpoint = [*state.target_TCP_pose]
        return self._setpoint

    def registers(self, action: Sequence[float], state: "Snapshot", step_s: float) -> Sequence[float]:
        allowed = [_within(low, at, high) for low, at, high in zip(self.bounds[0], action, self.bounds[1], strict=True)]
        self._setpoint = [*_towards(self._setpoint[:3], allowed, self._fastest * step_s), *self._setpoint[3:]]
        return self._setpoint


class JointPosition:
    """Joint angles [rad], approached at 1 rad/s."""

    script = f"servoj({_REGISTERS}, {_FOLLOWED})"

    def __init__(self, model: RobotModel, workspace: tuple[Vector3, Vector3]) -> None:
        self.bounds: Bounds = ([*model.q_min], [*model.q_max])
        self._setpoint: list[float] = []

    def begin(self, state: "Snapshot") -> Sequence[float]:
        self._setpoint = [*state.target_q]
        return self._setpoint

    def registers(self, action: Sequence[float], state: "Snapshot", step_s: float) -> Sequence[float]:
        self._setpoint = _towards(self._setpoint, action, _JOINT_RAD_S * step_s)
        return self._setpoint


CONTROL_MODES: Final[Mapping[str, type[TcpVelocity | JointVelocity | TcpPosition | JointPosition]]] = MappingProxyType(
    {
        "tcp_velocity": TcpVelocity,
        "tcp_position": TcpPosition,
        "joint_velocity": JointVelocity,
        "joint_position": JointPosition,
    }
)


def _fastest_m_s(model: RobotModel) -> float:
    return min(_FASTEST_M_S, _FASTEST_REACH_PER_S * model.reach_m)


def _towards(now: Sequence[float], wanted: Sequence[float], most: float) -> list[float]:
    """A setpoint that is at most this much nearer to the wanted one, on each axis."""
    return [at + _within(-most, to - at, most) for at, to in zip(now, wanted, strict=True)]


def _within(low: float, value: float, high: float) -> float:
    return min(max(value, low), high)
