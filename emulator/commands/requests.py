"""The commands that the ports send to the controller."""

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, Literal

from emulator.commands import dashboard, text_commands
from emulator.controller import Controller
from emulator.devices.gripper_requests import GripperSession
from emulator.fieldbus import modbus_map, rtde_inputs
from emulator.lifecycle.runstate import READ_ONLY_SOCKET
from emulator.mailbox import Command, deliver
from urproto.dashboard import failed
from urproto.modbus import ExceptionCode, exception_response
from urproto.robotiq import Request as GripperRequest
from urproto.text import strip

_TEXT_WORK: Final = 20  # measured: 10 to 40 microseconds
_LINE_WORK: Final = 10
_REGISTERS_WORK: Final = 5
_SHOWN = 60  # characters of a refused script in the log


@dataclass(frozen=True, slots=True)
class DashboardLine(Command):
    """One line of the dashboard server, without its line end. Answer: the reply line; None for an empty line.

    ``restricted``: the connection was opened while the arm was in local control.
    """

    price = _TEXT_WORK

    text: str
    restricted: bool = False

    def apply(self, controller: Controller) -> str | Generator[None, None, str | None] | None:
        return dashboard.execute(controller, self.text, restricted=self.restricted)

    @property
    def failure(self) -> str:
        return failed(strip(self.text))


@dataclass(frozen=True, slots=True)
class ScriptUnit(Command):
    """One program or line from a script port.

    A line that is a text command of the controller is carried out as such; everything else goes to the interpreter.
    ``origin``: who sent it, for the log of refused scripts.
    """

    price = _TEXT_WORK

    text: str
    kind: Literal["block", "line"]
    origin: str = field(default="a script", compare=False)

    def apply(self, controller: Controller) -> Generator[None, None, None]:
        """Done when it is decided whether the program starts, because the next unit may refer to it."""
        if self.kind == "line" and text_commands.execute(controller, self.text):
            return
        submission = controller.programs.submit(self.text, self.origin)
        while submission.accepted is None:
            yield


@dataclass(frozen=True, slots=True)
class RefusedScript(Command):
    """A program or line from a read-only connection. It is only reported, with the code C210."""

    price = _TEXT_WORK

    text: str
    origin: str = field(default="a script", compare=False)

    def apply(self, controller: Controller) -> None:
        controller.messages.error(READ_ONLY_SOCKET)
        controller.messages.note(f"script not executed: its connection is read-only: {self.text[:_SHOWN]!r}")
        controller.messages.refused(
            self.origin,
            "its connection is read-only; use ports 30001 to 30003 and, on e-Series, remote control, before connecting",
        )


@dataclass(frozen=True, slots=True)
class InterpreterLine(Command):
    """One line of the interpreter port. ``answer`` is called with the text to send back, possibly much later."""

    price = _LINE_WORK

    text: str
    answer: Callable[[str], None]

    def apply(self, controller: Controller) -> None:
        controller.programs.interpreter.receive(self.text, partial(deliver, self.answer))


@dataclass(frozen=True, slots=True)
class RTDEInputs(Command):
    """The values of one RTDE input package by variable name."""

    values: Mapping[str, Any]

    def apply(self, controller: Controller) -> None:
        rtde_inputs.apply_inputs(controller, self.values)


@dataclass(frozen=True, slots=True)
class ModbusCall(Command):
    """A request to the Modbus server: function code and data. Answer: function code and data of the response."""

    price = _REGISTERS_WORK

    pdu: bytes

    def apply(self, controller: Controller) -> bytes:
        return modbus_map.answer_request(controller, self.pdu)

    @property
    def failure(self) -> bytes:
        return exception_response(self.pdu[0], ExceptionCode.DEVICE_FAILURE)


@dataclass(frozen=True, slots=True)
class GripperCall(Command):
    """Requests of one client of the gripper. Answer: the bytes to send back."""

    price = _REGISTERS_WORK
    failure = b""

    requests: tuple[GripperRequest, ...]
    session: GripperSession

    def apply(self, controller: Controller) -> bytes:
        assert controller.gripper is not None, "the port is open only with a gripper"
        return self.session.answer(controller.gripper, self.requests)


@dataclass(frozen=True, slots=True)
class ToolBytes(Command):
    """Bytes for the device on the tool's serial line. The command is done when the line has room for them."""

    data: bytes

    def apply(self, controller: Controller) -> Generator[None, None, None]:
        while controller.tool_line.full:
            yield
        controller.tool_line.send(self.data)


@dataclass(frozen=True, slots=True)
class ServingFailed(Command):
    """A server failed to send the state of a control period to its clients."""

    server: str
    error: Exception

    def apply(self, controller: Controller) -> None:
        controller.guard.caught(f"serving the port {self.server!r}", self.error)
