"""Runs the caller's own scripts on the robot, and its dashboard commands."""

from pathlib import Path
from typing import TypeVar

from client import dashboard
from client.dashboard_commands import Operation
from client.driver import URDriver
from client.primary import PrimaryClient
from client.quantities import checked
from client.robot.motion import MotionRunner
from client.scripts import ScriptResult
from urproto.dashboard import ProgramState, UserRole
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.modes import RobotMode, SafetyMode, SafetyStatus
from urproto.text import from_bytes
from urproto.versions import PolyscopeVersion

Answer = TypeVar("Answer")


@checked
class RobotPrograms:
    """Runs programs other than the control program.

    A robot runs one program at a time, so the control program is stopped first and started again afterwards.
    """

    def __init__(self, motion: MotionRunner) -> None:
        self._motion = motion
        self._driver = motion.driver

    async def send(self, text: str) -> None:
        """Send a script without waiting for it. A ``sec`` program runs alongside the control program."""
        await self._driver.link.send_script(text)

    async def run(self, text: str, *, timeout_s: float = float("inf")) -> ScriptResult:
        """Run a ``def`` program, or bare statements, to the end; then restart the control program if it was running.

        Raises ScriptFailedError, with the line, if it fails, does not compile, or takes longer than ``timeout_s``.
        """
        await self._motion.check_free("the script")
        config = self._driver.config
        was_running = self._driver.program_running
        await self._driver.stop_program()
        try:
            async with PrimaryClient(config.host, config.robot_ports["primary"]) as primary:
                return await primary.run(primary.core.execute(text, timeout_s=timeout_s), float("inf"))
        finally:
            if was_running:
                await self._motion.readiness.restart_program("the script")

    async def run_function(self, name: str, body: str, *, timeout_s: float = float("inf")) -> ScriptResult:
        """Like `run`, with the body of a function of this name."""
        if not name.isidentifier():
            raise LocalProtocolError(f"{name!r} is not the name of a function")
        return await self.run(f"def {name}():\n{body}\nend\n", timeout_s=timeout_s)

    async def run_file(self, path: Path | str, *, timeout_s: float = float("inf")) -> ScriptResult:
        """Like `run`, with the script in a file."""
        return await self.run(from_bytes(Path(path).read_bytes()), timeout_s=timeout_s)


@checked
class Dashboard:
    """Dashboard commands: power, brakes, programs of the pendant, popups.

    They raise RobotRefused if the robot has no dashboard, like PolyScope X.
    """

    def __init__(self, driver: URDriver) -> None:
        self._driver = driver

    async def request(self, operation: Operation[Answer]) -> Answer:
        """Carry out any operation of `client.dashboard_commands`; use its ``command("...")`` for any other command."""
        board = self._driver.link.dashboard
        if board is None:
            raise RobotRefused(operation.line, "this robot has no dashboard", "PolyScope X has an HTTP API instead")
        return await board.request(operation)

    async def power_on(self) -> None:
        """Switch the arm on; the brakes stay closed."""
        await self.request(dashboard.POWER_ON)

    async def power_off(self) -> None:
        """Switch the arm off."""
        await self.request(dashboard.POWER_OFF)

    async def brake_release(self) -> None:
        """Release the brakes, after switching the arm on if necessary."""
        await self.request(dashboard.BRAKE_RELEASE)

    async def unlock_protective_stop(self) -> None:
        """End a protective stop, 5 s after it occurred; see also ``recover``."""
        await self.request(dashboard.UNLOCK_PROTECTIVE_STOP)

    async def restart_safety(self) -> None:
        """Restart the safety system after a safety fault or violation; the arm is off afterwards."""
        await self.request(dashboard.RESTART_SAFETY)

    async def close_safety_popup(self) -> None:
        """Close the popup of a safety stop."""
        await self.request(dashboard.CLOSE_SAFETY_POPUP)

    async def load(self, program: str) -> None:
        """Load a program of the pendant, ``.urp`` or ``.script``."""
        await self.request(dashboard.load(program))

    async def play(self) -> None:
        """Start the loaded program, or resume it if it is paused."""
        await self.request(dashboard.PLAY)

    async def pause(self) -> None:
        """Pause the running program."""
        await self.request(dashboard.PAUSE)

    async def stop(self) -> None:
        """Stop the running program."""
        await self.request(dashboard.STOP)

    async def popup(self, text: str) -> None:
        """Show a popup on the pendant."""
        await self.request(dashboard.popup(text))

    async def close_popup(self) -> None:
        """Close the popup."""
        await self.request(dashboard.CLOSE_POPUP)

    async def add_to_log(self, text: str) -> None:
        """Write a line to the robot's log."""
        await self.request(dashboard.add_to_log(text))

    async def shutdown(self) -> None:
        """Switch the robot and its controller off."""
        await self.request(dashboard.SHUTDOWN)

    async def set_user_role(self, role: UserRole) -> None:
        """Set the user role, which restricts the use of the pendant; CB3."""
        await self.request(dashboard.set_user_role(role))

    async def robot_mode(self) -> RobotMode:
        """Robot mode, as the dashboard reports it."""
        return await self.request(dashboard.ROBOT_MODE)

    async def safety_mode(self) -> SafetyMode:
        """Safety mode, as the dashboard reports it."""
        return await self.request(dashboard.SAFETY_MODE)

    async def safety_status(self) -> SafetyStatus:
        """Safety status, more detailed than the safety mode; PolyScope 3.11 and 5.4 or newer."""
        return await self.request(dashboard.SAFETY_STATUS)

    async def running(self) -> bool:
        """Whether a program is running."""
        return await self.request(dashboard.IS_RUNNING)

    async def program_state(self) -> tuple[ProgramState, str | None]:
        """State of the loaded program, and its name."""
        return await self.request(dashboard.PROGRAM_STATE)

    async def loaded_program(self) -> str | None:
        """Path of the loaded program; None without one."""
        return await self.request(dashboard.LOADED_PROGRAM)

    async def is_program_saved(self) -> tuple[bool, str | None]:
        """Whether the loaded program has no unsaved changes, and its name."""
        return await self.request(dashboard.IS_PROGRAM_SAVED)

    async def is_in_remote_control(self) -> bool:
        """Whether the robot is in remote control, and so accepts scripts; e-Series."""
        return await self.request(dashboard.IS_IN_REMOTE_CONTROL)

    async def polyscope_version(self) -> PolyscopeVersion:
        """Version of the robot's software."""
        return await self.request(dashboard.POLYSCOPE_VERSION)

    async def robot_model(self) -> str:
        """Model of the arm: UR3, UR5, ...; PolyScope 3.12 and 5.6 or newer."""
        return await self.request(dashboard.ROBOT_MODEL)

    async def serial_number(self) -> str:
        """Serial number of the robot; PolyScope 3.12 and 5.6 or newer."""
        return await self.request(dashboard.SERIAL_NUMBER)
