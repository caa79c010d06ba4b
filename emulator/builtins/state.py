"""State of the arm and the controller."""

import math
from typing import Any

from emulator.builtins.geometry import active_tcp, forward, twist_of
from emulator.builtins.host import ProgramHost
from urproto.rtde.fields import OUTPUT_FIELDS
from urproto.vectors import ZERO6
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Int, Pose, Str

LIBRARY = Library("state", host=True)


@LIBRARY.builtin()
def random(host: ProgramHost) -> float:
    """A number from 0 to 1, 1 not included; the same ones from each robot with the same seed."""
    return host.programs.chance.random()


@LIBRARY.builtin()
def get_actual_joint_positions(host: ProgramHost) -> list[float]:
    """Measured joint angles [rad]."""
    return list(host.actual_q)


@LIBRARY.builtin(note="old name of get_actual_joint_positions")
def get_joint_positions(host: ProgramHost) -> list[float]:
    """Measured joint angles [rad]."""
    return list(host.actual_q)


@LIBRARY.builtin()
def get_actual_joint_positions_history(host: ProgramHost, steps: Int = 0) -> list[float]:
    """Measured joint angles [rad] `steps` control periods ago; beyond the history, the oldest known."""
    if steps < 0:
        raise RuntimeFault(f"get_actual_joint_positions_history: steps must be 0 or more, not {steps}")
    return list(host.programs.history.q_ago(steps) or host.actual_q)


@LIBRARY.builtin()
def get_actual_joint_speeds(host: ProgramHost) -> list[float]:
    """Measured joint speeds [rad/s]."""
    return list(host.arm.measured_qd)


@LIBRARY.builtin(cb3=None, e="5.20")
def get_actual_joint_accelerations(host: ProgramHost) -> list[float]:
    """Measured joint accelerations [rad/s2]."""
    return list(host.arm.qdd)


@LIBRARY.builtin()
def get_target_joint_positions(host: ProgramHost) -> list[float]:
    """Commanded joint angles [rad]."""
    return list(host.target_q)


@LIBRARY.builtin()
def get_target_joint_speeds(host: ProgramHost) -> list[float]:
    """Commanded joint speeds [rad/s]."""
    return list(host.motion.qd)


@LIBRARY.builtin(cb3=None, e="5.20")
def get_target_joint_accelerations(host: ProgramHost) -> list[float]:
    """Commanded joint accelerations [rad/s2]."""
    return list(host.motion.qdd)


@LIBRARY.builtin(work=130)
def get_actual_tcp_pose(host: ProgramHost) -> Pose:
    """Measured TCP pose in the base frame."""
    return Pose(forward(host, host.actual_q))


@LIBRARY.builtin(work=300)
def get_actual_tcp_speed(host: ProgramHost) -> list[float]:
    """Measured TCP velocity in the base frame [m/s, rad/s]."""
    return list(twist_of(host, host.arm.measured_q, host.arm.measured_qd))


@LIBRARY.builtin(work=130)
def get_actual_tool_flange_pose(host: ProgramHost) -> Pose:
    """Measured pose of the tool flange in the base frame."""
    return Pose(forward(host, host.actual_q, ZERO6))


@LIBRARY.builtin(note="undocumented; PolyScope's force nodes use it", work=130)
def tool_pose(host: ProgramHost) -> Pose:
    """Measured TCP pose in the base frame."""
    return Pose(forward(host, host.actual_q))


@LIBRARY.builtin(work=130)
def get_target_tcp_pose(host: ProgramHost) -> Pose:
    """Commanded TCP pose in the base frame."""
    return Pose(forward(host, host.target_q))


@LIBRARY.builtin(work=300)
def get_target_tcp_speed(host: ProgramHost) -> list[float]:
    """Commanded TCP velocity in the base frame [m/s, rad/s]."""
    return list(twist_of(host, host.motion.q, host.motion.qd))


# Script Manual CB3 3.15.4, and not yet that of 3.10; that 3.11 has the two is a guess.
@LIBRARY.builtin(cb3="3.11", e="5.0", work=130)
def get_target_tcp_pose_along_path(host: ProgramHost) -> Pose:
    """Commanded TCP pose as it would be without path offset and conveyor tracking."""
    return Pose(forward(host, host.motion.path_q))


@LIBRARY.builtin(cb3="3.11", e="5.0", work=300)
def get_target_tcp_speed_along_path(host: ProgramHost) -> list[float]:
    """Commanded TCP velocity as it would be without path offset and conveyor tracking [m/s, rad/s]."""
    return list(twist_of(host, host.motion.path_q, host.motion.path_qd))


@LIBRARY.builtin(work=130)
def get_target_waypoint(host: ProgramHost) -> Pose:
    """Target TCP pose of the present movement, without path offset and conveyor; at rest, the pose on the path."""
    waypoint = host.motion.target_waypoint
    return Pose(forward(host, host.target_q) if waypoint is None else waypoint)


@LIBRARY.builtin()
def get_tcp_offset(host: ProgramHost) -> Pose:
    """The active TCP, as a pose relative to the tool flange."""
    return Pose(active_tcp(host))


@LIBRARY.builtin()
def get_tcp_force(host: ProgramHost) -> list[float]:
    """External force and torque in base axes [N, Nm].

    About the flange on e-Series, where the sensor is; at the TCP on CB3, and with an external sensor.
    """
    return list(host.arm.state.sensors.force)


@LIBRARY.builtin()
def force(host: ProgramHost) -> float:
    """Magnitude of the external force at the TCP [N]."""
    return math.hypot(*host.arm.tcp_force[:3])


@LIBRARY.builtin()
def get_joint_torques(host: ProgramHost) -> list[float]:
    """External joint torques [Nm]: those beyond the torques that move and hold the arm itself."""
    return list(host.arm.external_torque)


@LIBRARY.builtin()
def get_joint_temp(host: ProgramHost, j: Int) -> float:
    """Temperature of joint `j` (0 to 5) [degC]."""
    if not 0 <= j <= 5:
        raise RuntimeFault(f"get_joint_temp: there is no joint {j}: they are 0 to 5")
    return host.machine.electrics.thermals.joints[j]


@LIBRARY.builtin()
def get_controller_temp(host: ProgramHost) -> float:
    """Temperature of the control box [degC], as in the masterboard data of the primary interface."""
    return host.machine.electrics.thermals.box


@LIBRARY.builtin(cb3=None, e="5.0")
def get_tool_temp(host: ProgramHost) -> float:
    """Temperature of the tool flange [degC]."""
    return host.machine.electrics.thermals.tool


@LIBRARY.builtin()
def get_tool_current(_: ProgramHost) -> float:
    """Current of the tool supply [A]; 0, since tools take none."""
    return 0.0


@LIBRARY.builtin()
def get_tool_accelerometer_reading(host: ProgramHost) -> list[float]:
    """Acceleration measured in the tool flange, gravity included [m/s2]."""
    return list(host.arm.state.sensors.acceleration)


@LIBRARY.builtin()
def is_steady(host: ProgramHost) -> bool:
    """Whether the arm has stood still for a while and is in neither force mode nor freedrive."""
    return host.motion.steady


@LIBRARY.builtin(cb3="3.2", e="5.0")
def get_steptime(host: ProgramHost) -> float:
    """Control period [s]: 0.008 on CB3, 0.002 on e-Series."""
    return host.period_s


@LIBRARY.builtin(cb3=None, e="5.10")
def get_rtde_value(host: ProgramHost, key: Str) -> Any:
    """Value of the RTDE output variable of that name, as last published."""
    field = OUTPUT_FIELDS.get(key)
    if field is None or not field.available.covers(host.machine.version):
        raise RuntimeFault(f"get_rtde_value: there is no RTDE output variable {key!r} in this version")
    value = field.read(host.machine.snapshot)
    return list(value) if isinstance(value, tuple) else value
