"""Brings an arm to a mode, from any other mode, as the action ``set_mode`` does; runs next to the control loop."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from client import dashboard
from client.dashboard import DashboardClient
from client.driver import URDriver
from client.driver.link import MOVABLE
from client.errors import ClientError
from client.primary import BRAKE_RELEASE, POWER_OFF, POWER_ON, STOP_PROGRAM, PrimaryClient, TextCommand
from urproto.errors import RobotRefused
from urproto.modes import RobotMode, RuntimeState, SafetyMode, mode_of

_EFFECT_S: Final = 30.0  # as long as the dashboard's services wait
_PLAY_AFTER_S: Final = 1.0  # the ROS 2 driver: a robot refuses to play immediately after releasing its brakes

_COMMANDS: Final[Mapping[int, TextCommand]] = {
    RobotMode.POWER_OFF: POWER_OFF,
    RobotMode.IDLE: POWER_ON,
    RobotMode.RUNNING: BRAKE_RELEASE,
}
"""The modes that can be requested, with the command that leads there; they are also the modes to start from."""
_ADVICE: Final[Mapping[int, str]] = {
    RobotMode.CONFIRM_SAFETY: "confirm the safety configuration on the teach pendant",
    RobotMode.BOOTING: "wait until it has booted",
    RobotMode.POWER_ON: "wait until it is IDLE",
    RobotMode.BACKDRIVE: "let go of the teach button",
}
_EMERGENCY: Final = (SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP)
_BROKEN: Final = (SafetyMode.VIOLATION, SafetyMode.FAULT)

Modes = tuple[RobotMode, SafetyMode]


@dataclass(frozen=True)
class ModeRequest:
    """A goal of ``set_mode``.

    target: number of the mode. stop: end a running program first. play: once it is RUNNING, send the control program
    (headless), or play the program that is loaded on the pendant. address: the robot's.
    """

    target: int
    stop: bool
    play: bool
    headless: bool
    address: str


class ModeSetter:
    """Carries out one request."""

    def __init__(self, driver: URDriver, request: ModeRequest) -> None:
        self._driver = driver
        self._link = driver.link
        self._request = request

    async def execute(self, show: Callable[[Modes], object]) -> None:
        """Bring the arm to the mode; show is called with the modes when one changes. Raises URError."""
        last = self._modes

        def report(state: Mapping[str, Any]) -> None:
            nonlocal last
            if self._modes != last:
                last = self._modes
                show(last)

        self._link.on_modes.append(report)
        try:
            await self._set_mode()
        finally:
            self._link.on_modes.remove(report)

    @property
    def _modes(self) -> Modes:
        return self._link.robot_mode, self._link.safety_mode

    async def _set_mode(self) -> None:
        wanted, target = self._request, mode_of(RobotMode, self._request.target)
        if target not in _COMMANDS:
            raise ClientError(f"{target.name} cannot be requested: choose POWER_OFF (3), IDLE (5) or RUNNING (7)")
        if wanted.stop and self._driver.program_running:
            await self._command(STOP_PROGRAM)
        if self._link.robot_mode != target or self._link.safety_mode not in MOVABLE:
            await self._recover()
            await self._switch(target)
        await self._wait_until(lambda: self._link.robot_mode == target, target.name)
        if wanted.play and target is RobotMode.RUNNING and not self._driver.program_running:
            await self._play()

    async def _recover(self) -> None:
        """Resolve safety modes that prevent any change of mode."""
        mode = self._link.safety_mode
        if mode in _EMERGENCY:
            raise RobotRefused("set_mode", f"it is in {mode.name}", "release the emergency stop")
        if mode is SafetyMode.PROTECTIVE_STOP:
            await self._link.unlock_protective_stop()
        elif mode in _BROKEN:
            await self._send_dashboard(dashboard.RESTART_SAFETY)
            await self._wait_until(self._is_safe_and_off, "POWER_OFF after its safety was restarted")

    def _is_safe_and_off(self) -> bool:
        return self._link.robot_mode is RobotMode.POWER_OFF and self._link.safety_mode in MOVABLE

    async def _switch(self, target: RobotMode) -> None:
        mode = self._link.robot_mode
        if mode not in _COMMANDS:
            raise RobotRefused("set_mode", f"its mode is {mode.name}", _ADVICE.get(mode, "check its teach pendant"))
        if mode is RobotMode.RUNNING and target is RobotMode.IDLE:  # brakes are engaged by switching the arm off only
            await self._command(POWER_OFF)
        await self._command(_COMMANDS[target])

    async def _play(self) -> None:
        if self._request.headless:
            await self._driver.start_program()
            return
        await asyncio.sleep(_PLAY_AFTER_S)
        await self._send_dashboard(dashboard.PLAY)
        await self._wait_until(lambda: self._link.state["runtime_state"] == RuntimeState.PLAYING, "PLAYING")

    async def _command(self, command: TextCommand) -> None:
        """Send a command through a new connection: one opened in local control takes no commands in remote control."""
        async with PrimaryClient(self._request.address, self._driver.config.robot_ports["primary"]) as primary:
            await primary.run(primary.core.command(command))

    async def _send_dashboard(self, operation: "dashboard.Operation[None]") -> None:
        ports = self._driver.config.robot_ports
        async with DashboardClient(
            self._request.address, ports["dashboard"], robot_api_port=ports.get("robot api")
        ) as board:
            await board.request(operation)

    async def _wait_until(self, reached: Callable[[], bool], state_text: str) -> None:
        until_s = asyncio.get_running_loop().time() + _EFFECT_S
        while not reached():
            if asyncio.get_running_loop().time() > until_s:
                modes = " and ".join(mode.name for mode in self._modes)
                raise RobotRefused("set_mode", f"it is not {state_text} after {_EFFECT_S:g} s, but {modes}")
            await self._link.next_state()
