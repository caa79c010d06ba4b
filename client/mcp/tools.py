"""The tools, functions whose docstrings an assistant reads, and the server that has them; errors are one line.

Units are in the names of arguments and results.
"""

import asyncio
import inspect
import json
import subprocess
from collections.abc import Awaitable, Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any, Final, TypeVar

from mcp.server.mcpserver import Image, MCPServer
from mcp.server.mcpserver.exceptions import ToolError
from mcp.types import ToolAnnotations

from client import dashboard, primary, rtde
from client.cameras import CameraClient
from client.dashboard_commands import checked_command
from client.driver.config import robot_ports
from client.errors import ClientError
from client.programs import controller, script_problems
from client.robot import AsyncRobot
from client.scripts import is_secondary
from urproto.addresses import is_loopback
from urproto.compat import module_command
from urproto.compat_asyncio import timeout
from urproto.controlapi import ControlClient, NoAccessError
from urproto.errorcodes import error_text
from urproto.errors import RobotRefused, URError
from urproto.modes import MODE_OUTPUTS, mode_name
from urproto.ports import CAMERA_PORT, CONTROL_API_PORT
from urproto.text import from_bytes, to_bytes

EMULATOR: Final = "an emulator: nothing real moves"
REAL: Final = "a real arm, or a simulator of the vendor: treat it as a real arm"

_STATE: Final = {
    "timestamp": "uptime_s",
    **{name: name for name in MODE_OUTPUTS},
    "target_speed_fraction": "speed_slider",
    "actual_q": "joints_rad",
    "actual_qd": "joint_speeds_rad_s",
    "actual_TCP_pose": "tcp_pose_base_m_rotvec_rad",
    "actual_digital_input_bits": "digital_input_bits",
    "actual_digital_output_bits": "digital_output_bits",
}
_ASKING_S: Final = 2.0  # guess: how long an emulator takes to say that it is one
_COMPUTING_S: Final = 120.0  # guess: this machine's time for a program in virtual time
_MOST_TEXT: Final = 20_000  # characters of a program's output; guess: more fills an assistant's context
_STARTING_S: Final = 30.0  # guess: until a program runs
_LONGEST_S: Final = 600.0  # guess: longer than any single motion or program takes

_Tool = TypeVar("_Tool", bound=Callable[..., Awaitable[Any]])

READING: Final[list[Callable[..., Awaitable[Any]]]] = []
"""Tools that change nothing outside this machine's processes."""
CHANGING: Final[list[Callable[..., Awaitable[Any]]]] = []
"""Tools that exist only with consent to motion."""

_INSTRUCTIONS = """Tools for Universal Robots arms. Each answer says in answered_by whether an emulator or a real arm
spoke; a real arm can hurt people. Try programs with check_program and try_program before they are sent to a robot.
Angles are in rad, lengths in m. {}"""
_READ_ONLY = "Nothing moves: the person who started this server did not pass --allow-motion."
_MOTION = "The person who started this server allowed motion."


def _reading(tool: _Tool) -> _Tool:
    READING.append(tool)
    return tool


def _changing(tool: _Tool) -> _Tool:
    CHANGING.append(tool)
    return tool


@dataclass(frozen=True)
class Consent:
    """addresses: robots beyond this machine. motion: whether tools may move arms and change robots."""

    addresses: frozenset[str] = frozenset()
    motion: bool = False

    def check(self, address: str) -> None:
        """Raise ClientError for the address of a robot to which the person did not agree."""
        if not is_loopback(address) and address not in self.addresses:
            known = ", ".join(sorted(self.addresses)) or "none"
            raise ClientError(
                f"{address!r} is not on this machine, and the person who started this server did not agree to it "
                f"(agreed: {known}): ask them to add --allow {address}"
            )


class Tools:
    """Each tool is a method, marked by what it does. port_offset: added to each port of every robot."""

    def __init__(self, consent: Consent, robot_ip: str = "127.0.0.1", port_offset: int = 0) -> None:
        self._consent = consent
        self._robot_ip = robot_ip
        self._offset = port_offset

    # what changes nothing

    @_reading
    async def read_state(self, robot_ip: str = "") -> dict[str, Any]:
        """Modes, joint angles, TCP pose, speeds and digital signals of a robot, now.

        robot_ip: empty for the robot that the server was started for; every other tool takes it, too.
        """
        host = self._host(robot_ip)
        async with rtde.RTDEClient(host, tuple(_STATE), port=rtde.PORT + self._offset) as client:
            state = await client.receive()
            version = str(client.core.version)
        named = {
            _STATE[name]: mode_name(MODE_OUTPUTS[name], value) if name in MODE_OUTPUTS else value
            for name, value in state.items()
        }
        return await self._answer(host, {"polyscope": version, **named})

    @_reading
    async def check_program(self, program: str, polyscope: str = "3.15") -> dict[str, Any]:
        """Find mistakes in a URScript program without a robot. polyscope: the version that it is for."""
        _, version = controller(None, polyscope)
        found = await asyncio.to_thread(script_problems, program, version)
        problems = [
            {
                "line": one.line,
                "column": one.column,
                "severity": "warning" if one.warning else "error",
                "text": one.message,
            }
            for one in found
        ]
        return {"polyscope": str(version), "problems": problems}

    @_reading
    async def try_program(
        self, program: str, model: str = "ur3", polyscope: str = "", robot_time_s: float = 60.0, trace: bool = False
    ) -> dict[str, Any]:
        """Execute a URScript program on an emulated arm of its own, in virtual time: nothing real moves.

        The answer has what the program printed, its errors by line, and where the arm ended. model: ur3, ur5e and so
        on. robot_time_s: stop after so much of the robot's time. trace: show each statement. It has no network.
        """
        arm, version = controller(model, polyscope or None)
        return await _run(
            *module_command("urscript"),
            *("run", f"--model={arm.name}", f"--polyscope={version}", f"--timeout={robot_time_s}"),
            *("--script-network=none", *(["--trace"] if trace else []), "-"),
            program=program,
        )

    @_reading
    async def replay_journal(self, file: str, until: str = "") -> dict[str, Any]:
        """Execute the recorded run of an emulator (a .journal file) again, and say whether it is the same.

        until: stop at this uptime [s], or at a condition such as "safety_mode != NORMAL".
        """
        path = Path(file).absolute()
        if path.suffix != ".journal" or not path.is_file():
            raise ClientError(f"{path} is not a .journal file on this machine")
        return await _run(*module_command("emulator"), "replay", *([f"--until={until}"] if until else []), str(path))

    @_reading
    async def explain_error_code(self, code: int, argument: int = 0) -> dict[str, Any]:
        """What a code of the robot's log means: C153A1 is code 153, argument 1."""
        return {"code": f"C{code}A{argument}", "meaning": error_text(code, argument)}

    @_reading
    async def take_picture(self, camera: str = "", robot_ip: str = "") -> list[Any]:
        """A picture of a camera of an emulator's scene, taken now. camera: empty for the first one."""
        host = self._host(robot_ip)

        def take() -> tuple[str, bytes, float]:
            with CameraClient(host, CAMERA_PORT + self._offset) as client:
                chosen = client.chosen([camera] if camera else [one.name for one in client.cameras()[:1]])[0]
                shot = client.shot(chosen, "rgb.jpg")
                return chosen.name, shot.data, shot.time_s

        name, data, time_s = await asyncio.to_thread(take)
        answer = await self._answer(host, {"camera": name, "uptime_s": time_s})
        return [json.dumps(answer), Image(data=data, format="jpeg")]

    @_reading
    async def list_emulator_verbs(self, robot_ip: str = "") -> dict[str, Any]:
        """What `use_emulator` can do: faults, inputs, safety devices, time, the world. Only emulators have verbs."""
        host = self._host(robot_ip)
        return await self._answer(host, {"verbs": await asyncio.to_thread(self._ask, host, ControlClient.verbs)})

    # what moves an arm, or changes a robot

    @_changing
    async def make_ready(self, robot_ip: str = "") -> dict[str, Any]:
        """Power the arm on and release its brakes, as far as that is still to be done. The arm moves slightly."""
        return await self._with_robot(robot_ip, lambda robot: robot.make_ready(program=False))

    @_changing
    async def unlock_protective_stop(self, robot_ip: str = "") -> dict[str, Any]:
        """Unlock a protective stop, 5 s after it occurred. Only when it is clear why the arm stopped."""
        return await self._with_robot(robot_ip, lambda robot: robot.recover())

    @_changing
    async def move_joints(
        self, joints_rad: list[float], speed_rad_s: float = 0.5, robot_ip: str = ""
    ) -> dict[str, Any]:
        """Move to six joint angles, base to wrist 3, and wait. speed_rad_s: of the joint with the longest way."""
        return await self._with_robot(robot_ip, lambda robot: robot.move_j(joints_rad, speed_rad_s=speed_rad_s))

    @_changing
    async def move_tcp(
        self, pose_base_m_rotvec_rad: list[float], speed_m_s: float = 0.1, robot_ip: str = ""
    ) -> dict[str, Any]:
        """Move the TCP in a straight line to a pose in the base frame, x y z rx ry rz, and wait."""
        return await self._with_robot(robot_ip, lambda robot: robot.move_l(pose_base_m_rotvec_rad, speed_m_s=speed_m_s))

    @_changing
    async def set_digital_output(self, number: int, on: bool, robot_ip: str = "") -> dict[str, Any]:
        """Switch a digital output: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool."""
        return await self._with_robot(robot_ip, lambda robot: robot.set_digital_out(number, on))

    @_changing
    async def send_program(self, program: str, wait_s: float = 60.0, robot_ip: str = "") -> dict[str, Any]:
        """Check a URScript program, run it on the robot, and wait for its end: its texts, and errors by line.

        A program that takes longer than wait_s [s] goes on; the dashboard command "stop" ends it.
        """
        host = self._host(robot_ip)
        async with primary.PrimaryClient(host, primary.PORT + self._offset) as client:
            version = await client.run(client.core.polyscope_version())
            for problem in await asyncio.to_thread(script_problems, program, version):
                if not problem.warning:
                    raise ClientError(f"nothing was sent: line {problem.line}: {problem.message}")
            if is_secondary(program):
                await client.run(client.core.send_secondary(program))
                return await self._answer(host, {"sent": "a secondary program, whose end a robot does not report"})
            limit_s = min(wait_s, _LONGEST_S)
            result = await client.run(client.core.execute(program, timeout_s=limit_s), limit_s + _STARTING_S)
        return await self._answer(host, {"program": result.name, "ended": True, "texts": result.texts})

    @_changing
    async def send_dashboard_command(self, command: str, robot_ip: str = "") -> dict[str, Any]:
        """Send a dashboard command, such as "stop", "play", "load cell.urp" or "unlock protective stop"."""
        host, operation = self._host(robot_ip), checked_command(command)
        async with dashboard.DashboardClient(host, dashboard.PORT + self._offset) as client:
            try:
                answer, done = await client.request(operation), True
            except RobotRefused as refusal:
                answer, done = refusal.answer, False
        return await self._answer(host, {"command": command, "answer": answer, "done": done})

    @_changing
    async def use_emulator(self, verb: str, arguments: dict[str, Any], robot_ip: str = "") -> dict[str, Any]:
        """Use a verb of `list_emulator_verbs`: inject a fault, set an input, stop or pass time, move an object."""
        host = self._host(robot_ip)
        result = await asyncio.to_thread(self._ask, host, lambda control: control.call(verb, arguments))
        return await self._answer(host, {"result": result})

    # shared

    def _host(self, robot_ip: str) -> str:
        host = robot_ip or self._robot_ip
        self._consent.check(host)
        return host

    def _ask(self, host: str, question: Callable[[ControlClient], Any], timeout_s: float = 60.0) -> Any:
        with closing(ControlClient(host, CONTROL_API_PORT + self._offset, timeout_s=timeout_s)) as control:
            return question(control)

    async def _answer(self, host: str, content: Mapping[str, Any]) -> dict[str, Any]:
        return {"answered_by": f"{host}, {await asyncio.to_thread(self._kind, host)}", **content}

    def _kind(self, host: str) -> str:
        try:
            self._ask(host, ControlClient.verbs, _ASKING_S)
        except NoAccessError:  # only an emulator has a token
            return EMULATOR
        except URError:
            return REAL
        return EMULATOR

    async def _with_robot(self, robot_ip: str, act: Callable[[AsyncRobot], Any]) -> dict[str, Any]:
        host = self._host(robot_ip)
        async with timeout(_LONGEST_S), AsyncRobot(host, robot_ports=robot_ports(self._offset)) as robot:
            await act(robot)
        return await self.read_state(host)


async def _run(*command: str, program: str = "") -> dict[str, Any]:
    def run() -> dict[str, Any]:
        try:
            ended = subprocess.run(command, input=to_bytes(program), capture_output=True, timeout=_COMPUTING_S)
        except subprocess.TimeoutExpired:
            raise ClientError(
                f"it was not over after {_COMPUTING_S:g} s of this machine's time: try less of it"
            ) from None
        texts = [from_bytes(output).strip() for output in (ended.stdout, ended.stderr)]
        shown = "\n".join(text for text in texts if text)
        if len(shown) > _MOST_TEXT:
            shown = f"{shown[:_MOST_TEXT]}\n({len(shown) - _MOST_TEXT} more characters)"
        return {"succeeded": ended.returncode == 0, "output": shown}

    return await asyncio.to_thread(run)


def make_server(tools: Tools, consent: Consent, version: str) -> MCPServer[None]:
    """A server with the tools that the consent covers."""
    server: MCPServer[None] = MCPServer(
        "ur-client",
        title="Universal Robots",
        instructions=_INSTRUCTIONS.format(_MOTION if consent.motion else _READ_ONLY),
        version=version,
        log_level="WARNING",
    )
    for tool in (*READING, *(CHANGING if consent.motion else ())):
        moves = tool in CHANGING
        hints = ToolAnnotations(read_only_hint=not moves, destructive_hint=moves, open_world_hint=False)
        server.add_tool(_in_words(getattr(tools, tool.__name__)), annotations=hints)
    return server


def _in_words(tool: Callable[..., Awaitable[Any]]) -> Callable[..., Awaitable[Any]]:
    @wraps(tool)
    async def call(*values: Any, **named: Any) -> Any:
        try:
            return await tool(*values, **named)
        except (URError, OSError, ValueError, TimeoutError) as error:
            raise ToolError(str(error) or type(error).__name__) from error

    call.__signature__ = inspect.signature(tool)  # type: ignore[attr-defined]
    return call
