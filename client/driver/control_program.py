"""The control program, which runs on the robot so that a driver can move it (External Control).

    text = ControlProgram(host="192.168.56.1").render(PolyscopeVersion(5, 12))

The template is control_program.script, next to this file. This module fills in its placeholders, such as the driver's
address, and selects the parts for the robot's version: those between ``{{if FEATURE}}``, ``{{elif FEATURE}}``,
``{{else}}`` and ``{{end}}``, with the features of `client.driver.availability`. Every function that the program calls
must exist in the robot's version, because a controller refuses a program that contains an unknown name.
"""

import re
from collections.abc import Iterator
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

_CONDITION: Final = re.compile(r"\{\{(if|elif|else|end) ?(\w*)\}\}")


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
        text = "\n".join(_parts_for(version)) + "\n"
        for place, value in self._places().items():
            text = text.replace("{{" + place + "}}", value)
        return text

    def render_headless(self, version: PolyscopeVersion) -> str:
        """The program in the form that a script port accepts: a def with the name PROGRAM_NAME."""
        lines = "".join(f"  {line}\n" if line else "\n" for line in self.render(version).splitlines())
        return f"def {PROGRAM_NAME}():\n{lines}end\n"

    def _places(self) -> dict[str, str]:
        return {
            "BEGIN": self._begin(),
            "LOOKAHEAD": str(self.servoj_lookahead_s),
            "GAIN": str(self.servoj_gain),
            "ACCELERATION": str(SPEED_ACCELERATION),
            "DECELERATION": str(DECELERATION),
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


def _parts_for(version: PolyscopeVersion) -> Iterator[str]:
    """The lines of the template for a version."""
    selected, done = True, False  # done: a part of this condition has been selected
    for line in _template().splitlines():
        condition = _CONDITION.fullmatch(line)
        if condition is None:
            if selected:
                yield line
            continue
        word, feature = condition.groups()
        done = done and word != "if"
        selected = word == "end" or (not done and (word == "else" or offers(feature, version)))
        done = done or selected
