"""The control program, which runs on the robot so that a driver can move it (External Control).

    text = ControlProgram(host="192.168.56.1").render(PolyscopeVersion(5, 12))

The template is control_program.script, next to this file. This module fills in its placeholders: the driver's address,
and the parts that differ between PolyScope versions. Every function that the program calls must exist in the robot's
version, because a controller refuses a program that contains an unknown name.
"""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Final

from client.driver.availability import offers
from urproto.errors import LocalProtocolError
from urproto.external_control import GREETING
from urproto.versions import PolyscopeVersion

PROGRAM_NAME: Final = "external_control"

SPEED_ACCELERATION: Final = 40.0  # rad/s2 or m/s2, for streamed speeds; source: the client library
DECELERATION: Final = 4.0  # rad/s2, for coming to rest; source: the client library
GONE_TEXT: Final = "External Control: the driver is gone"
"""Beginning of the text that the program sends (textmsg) before it ends because its driver sent nothing."""
LATE_TEXT: Final = "External Control: no setpoint in time after message "
"""Beginning of the text that it sends when it brings the arm to rest because a setpoint is late; the number of the last
message of the reverse port follows. The program continues."""

# Shares of the joint friction that direct torque control compensates by default; source: the client library
_VISCOUS: Final = "[0.9, 0.9, 0.8, 0.9, 0.9, 0.9]"
_COULOMB: Final = "[0.8, 0.8, 0.7, 0.8, 0.8, 0.8]"

_TORQUE: Final = """thread ec_torque():
  while ec_mode == 8:
    direct_torque(ec_values, {friction})
  end
  stopj(4.0)
end"""
_NO_TORQUE: Final = """thread ec_torque():
  ec_refuse("This PolyScope version has no torque control.")
end"""
_OPTIMOVE: Final = """  elif kind == 4:
    optimovej(target, a=a, v=v, r=r)
  elif kind == 5:
    optimovel(ec_pose(target), a=a, v=v, r=r)
  elif kind == 12 and option > 0.5:
    optimovej(get_inverse_kin(ec_pose(target), second), a=a, v=v, r=r)
  elif kind == 12:
    optimovej(ec_pose(target), a=a, v=v, r=r)
  elif kind == 13:
    optimovel(target, a=a, v=v, r=r)"""
_GAIN_SCALING: Final = "force_mode_set_gain_scaling(words[28] / ec_scale)"
_CONTACT_DETECTION: Final = """thread ec_detect():
  while ec_detecting:
    if tool_contact(direction=ec_direction) > 0:
      ec_touched = True
    end
    sync()
  end
end

def ec_detect_contact(words):
  kill ec_detector
  ec_detecting = words[1] == 104
  if ec_detecting:
    ec_touched = False
    ec_direction = ec_six(words, 2)
    ec_detector = run ec_detect()
  end
end"""
_NO_CONTACT_DETECTION: Final = """def ec_detect_contact(words):
  ec_detecting = False
end"""
_QUESTIONS: Final = {
    "inverse_kin": """  elif query == 1:
    if get_inverse_kin_has_solution(ec_pose(ec_first), near, tcp=tcp):
      ec_answer_six(get_inverse_kin(ec_pose(ec_first), near, tcp=tcp))
    else:
      ec_begin_answer(0)
    end
  elif query == 2:
    ec_answer_truth(get_inverse_kin_has_solution(ec_pose(ec_first), near, tcp=tcp))""",
    "contact": """  elif query == 11:
    ec_answer_truth(ec_touched)
  elif query == 12:
    ec_answer_six(get_actual_joint_positions_history(number))
  elif query == 14:
    ec_answer(tool_contact(direction=ec_first))""",
    "target_waypoint": """  elif query == 13:
    ec_answer_six(get_target_waypoint())""",
    "freedrive_axes": """  elif query == 15:
    ec_answer(get_freedrive_status())""",
    "dynamics": """  elif query == 16:
    ec_answer_matrix(get_jacobian(q, tcp))
  elif query == 17:
    ec_answer_matrix(get_jacobian_time_derivative(q, qd, tcp))
  elif query == 18:
    ec_answer_matrix(get_mass_matrix(q, number == 1))
  elif query == 19:
    ec_answer_six(get_coriolis_and_centrifugal_torques(q, qd))
  elif query == 20:
    ec_answer_six(get_target_joint_accelerations())""",
}
_INERTIA: Final = "set_target_payload(words[2] / ec_scale, ec_three(words, 3), ec_six(words, 6), words[12] / ec_scale)"
_NO_INERTIA: Final = "set_payload(words[2] / ec_scale, ec_three(words, 3))"


@dataclass(frozen=True, slots=True)
class ToolCommunicationSettings:
    """Settings of an e-Series tool's serial line: parity 0 none, 1 odd, 2 even; idle times in characters."""

    baud_rate: int = 115200
    parity: int = 0
    stop_bits: int = 1
    rx_idle_chars: float = 1.5
    tx_idle_chars: float = 3.5

    @property
    def script(self) -> str:
        """The URScript statement that applies them."""
        options = (self.baud_rate, self.parity, self.stop_bits, self.rx_idle_chars, self.tx_idle_chars)
        return f"set_tool_communication(True, {', '.join(map(str, options))})"


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlProgram:
    """Parameters of the control program.

    host: the driver's address as the robot sees it; the ports are the driver's.
    servoj_lookahead_s (0.03 to 0.2) and servoj_gain (100 to 2000): smoothing of servoj.
    tool_voltage, tool_communication: set when the program starts; None leaves them unchanged.
    token: identifies the program to the driver on each connection; with "" the program sends no token.
    number: counts the programs of this driver.
    """

    host: str
    reverse_port: int = 50001
    trajectory_port: int = 50003
    command_port: int = 50004
    servoj_lookahead_s: float = 0.03
    servoj_gain: int = 2000
    tool_voltage: int | None = None
    tool_communication: ToolCommunicationSettings | None = None
    token: str = ""
    number: int = 0

    @property
    def gone_text(self) -> str:
        """The text that this program sends before it ends because its driver sent nothing; every client reads it."""
        return f"{GONE_TEXT} ({self.host}:{self.reverse_port}, program {self.number})"

    def __post_init__(self) -> None:
        check_servo_parameters(self.servoj_lookahead_s, self.servoj_gain)
        if '"' in self.host or not self.host.isprintable() or not self.host:
            raise LocalProtocolError(f"{self.host!r} is not an address")
        if self.token and not self.token.isalnum():
            raise LocalProtocolError(f"{self.token!r} is not a token: letters and digits only")

    def render(self, version: PolyscopeVersion) -> str:
        """The program in the form that the External Control URCap expects: bare statements between anchors."""
        text = _template()
        for place, value in self._places(version).items():
            text = text.replace("{{" + place + "}}", value)
        return text

    def render_headless(self, version: PolyscopeVersion) -> str:
        """The program in the form that a script port accepts: a def with the name PROGRAM_NAME."""
        lines = "".join(f"  {line}\n" if line else "\n" for line in self.render(version).splitlines())
        return f"def {PROGRAM_NAME}():\n{lines}end\n"

    def _places(self, version: PolyscopeVersion) -> dict[str, str]:
        return {
            "BEGIN": self._begin(),
            "LOOKAHEAD": str(self.servoj_lookahead_s),
            "GAIN": str(self.servoj_gain),
            "ACCELERATION": str(SPEED_ACCELERATION),
            "DECELERATION": str(DECELERATION),
            "QUESTIONS": "\n".join(lines for gate, lines in _QUESTIONS.items() if offers(gate, version)),
            "ACTIVE_TCP": "tcp = get_tcp_offset()" if offers("tcp_offset", version) else "",
            "CONTACT_DETECTION": _CONTACT_DETECTION if offers("contact", version) else _NO_CONTACT_DETECTION,
            "END_DETECTION": "kill ec_detector" if offers("contact", version) else "",
            "FREEDRIVE": (
                "freedrive_mode(freeAxes=ec_free_axes, feature=ec_free_frame)"
                if offers("freedrive_axes", version)
                else "freedrive_mode()"
            ),
            "GAIN_SCALING_ALONE": "force_mode_set_gain_scaling(words[3] / ec_scale)"
            if offers("force_mode_gain_scaling", version)
            else "",
            "TORQUE": _torque(version),
            "OPTIMOVE": _OPTIMOVE if offers("optimove", version) else "",
            "FT_INPUT": "ft_rtde_input_enable" if offers("ft_rtde_input", version) else "enable_external_ft_sensor",
            "GAIN_SCALING": _GAIN_SCALING if offers("force_mode_gain_scaling", version) else "",
            "TARGET_PAYLOAD": _INERTIA if offers("set_target_payload", version) else _NO_INERTIA,
            "GONE": self.gone_text,
            "LATE": LATE_TEXT,
            "GREET": f'socket_send_line("{GREETING.decode()}{self.token}", name)' if self.token else "",
            "HOST": self.host,
            "REVERSE_PORT": str(self.reverse_port),
            "TRAJECTORY_PORT": str(self.trajectory_port),
            "COMMAND_PORT": str(self.command_port),
            "VISCOUS": _VISCOUS,
            "COULOMB": _COULOMB,
        }

    def _begin(self) -> str:
        lines = [] if self.tool_voltage is None else [f"set_tool_voltage({self.tool_voltage})"]
        lines += [] if self.tool_communication is None else [self.tool_communication.script]
        return "\n".join(lines)


def check_servo_parameters(lookahead_s: float, gain: float) -> None:
    """Raise LocalProtocolError for values that servoj does not accept."""
    if not 0.03 <= lookahead_s <= 0.2:
        raise LocalProtocolError(f"the lookahead time of servoj is 0.03 to 0.2 s, not {lookahead_s}")
    if not 100 <= gain <= 2000:
        raise LocalProtocolError(f"the gain of servoj is 100 to 2000, not {gain}")


@cache
def _template() -> str:
    return files("client.driver").joinpath("control_program.script").read_text("utf-8")


def _torque(version: PolyscopeVersion) -> str:
    if offers("set_friction_scales", version):
        return _TORQUE.format(friction="viscous_scale=ec_viscous, coulomb_scale=ec_coulomb")
    return _TORQUE.format(friction="friction_comp=ec_friction_on") if offers("torque", version) else _NO_TORQUE
