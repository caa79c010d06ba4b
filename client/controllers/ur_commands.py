"""The command interfaces of a Universal Robots arm, and how the driver carries out those that are not motions."""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from typing import Any, Final, Protocol

from client.controllers.calls import FAILURE, SUCCESS
from client.controllers.compliance import FORCE_MODE_COMMANDS, ToolContactState
from client.controllers.controller import NO_COMMAND
from client.controllers.motion_primitives import PRIMITIVE_COMMANDS
from client.controllers.passthrough import PASSTHROUGH
from client.controllers.ur_states import PrefixedInterfaces, URStates
from client.errors import ClientError
from urproto.errors import URError
from urproto.external_control import TrajectoryPoint, TrajectoryResult
from urproto.joints import JOINT_NAMES
from urproto.signals import SIGNALS, digital_signal

_DIGITAL: Final = tuple(f"gpio/standard_digital_output_cmd_{pin}" for pin in range(SIGNALS))
_PAYLOAD: Final = ("payload/mass", "payload/cog.x", "payload/cog.y", "payload/cog.z")
_INERTIA: Final = (
    *(f"payload/inertia.i{axes}" for axes in ("xx", "yy", "zz", "xy", "xz", "yz")),
    "payload/transition_time",
)
_GRAVITY: Final = ("gravity/x", "gravity/y", "gravity/z")
_FRICTION: Final = tuple(f"friction_model/{kind}_{joint}" for kind in ("viscous", "coulomb") for joint in range(6))
_DOMAIN: Final = "gpio/analog_output_domain_cmd"
_ANALOG: Final = ("gpio/standard_analog_output_cmd_0", "gpio/standard_analog_output_cmd_1")
_IO_ANSWER: Final = "gpio/io_async_success"
_FORCE_ANSWER: Final = "force_mode/force_mode_async_success"
_CONTACT_NONE: Final = 3.0  # result while the robot is still watching for contact

_logger = logging.getLogger(__name__)

Spawn = Callable[[Coroutine[Any, Any, None]], "asyncio.Task[None]"]
"""Runs a coroutine in the background of the control cycle."""


class ScriptReceiver(Protocol):
    """The part of `client.driver.link.RobotLink` that is used here."""

    async def send_script(self, text: str) -> None: ...


class ArmDriver(Protocol):
    """The part of `client.driver.URDriver` that is used here."""

    @property
    def program_running(self) -> bool: ...
    @property
    def loss_reason(self) -> str: ...
    @property
    def link(self) -> ScriptReceiver: ...
    def servoj(self, q_rad: Sequence[float], timeout_s: float) -> None: ...
    def speedj(self, qd_rad_s: Sequence[float], timeout_s: float) -> None: ...
    def torque(self, torque_Nm: Sequence[float], timeout_s: float) -> None: ...
    def idle(self) -> None: ...
    def start_freedrive(self) -> None: ...
    def stop_freedrive(self) -> None: ...
    def start_force_mode(
        self,
        task_frame_base: Sequence[float],
        selection: Sequence[int],
        wrench: Sequence[float],
        kind: int,
        limits: Sequence[float],
        *,
        damping: float,
        gain_scaling: float,
    ) -> None: ...
    def end_force_mode(self) -> None: ...
    def start_tool_contact(self) -> None: ...
    def end_tool_contact(self) -> None: ...
    async def tool_contact_result(self) -> TrajectoryResult: ...
    async def execute(self, points: Sequence[TrajectoryPoint]) -> TrajectoryResult: ...
    async def start_program(self) -> None: ...
    async def stop_program(self) -> None: ...
    async def set_speed_slider(self, fraction: float) -> None: ...
    async def set_tool_voltage(self, volts: int) -> None: ...
    async def set_payload(self, mass_kg: float, cog_m: Sequence[float]) -> None: ...
    async def set_target_payload(
        self, mass_kg: float, cog_m: Sequence[float], inertia_kg_m2: Sequence[float], transition_time_s: float
    ) -> None: ...
    async def set_gravity(self, gravity_m_s2: Sequence[float]) -> None: ...
    async def zero_ftsensor(self) -> None: ...
    def set_friction_scales(self, viscous: Sequence[float], coulomb: Sequence[float]) -> None: ...


class URCommands(PrefixedInterfaces):
    """The command interfaces; `process` carries out one-time commands set on them."""

    def __init__(self, prefix: str, driver: ArmDriver, states: URStates, spawn: Spawn) -> None:
        super().__init__(prefix, _names())
        self._driver = driver
        self._states = states
        self._spawn = spawn
        self.contact: str | None = None  # what stopped the arm
        self._digital = self.part(_DIGITAL)
        self._contact = self.part(["tool_contact/tool_contact_set_state"])
        self._inertia = self.part(_INERTIA)
        self._requests = [(self.part(names), answer, action) for names, answer, action in self._table()]

    def process(self) -> None:
        """Start everything that has been set since the last cycle."""
        for part, answer, action in self._requests:
            if (values := part.take()) is not None:
                self._spawn(self._answered(answer, action(values)))
        self._switch_outputs()
        self._watch_contact()

    def refuse(self, reason: str) -> None:
        """Refuse everything that has been set since the last cycle."""
        refused = {answer for part, answer, _ in self._requests if part.take() is not None}
        if any(level == level for level in self._digital.get()):
            refused.add(_IO_ANSWER)
        for answer in refused:
            _logger.error("%s", reason)
            self[answer] = FAILURE
        if refused:
            for left in (self._digital, self._inertia, self.part([_DOMAIN])):
                left.fill(NO_COMMAND)

    def _table(self) -> list[tuple[Sequence[str], str, Callable[[list[float]], Awaitable[None]]]]:
        driver = self._driver
        return [
            ([_ANALOG[0]], _IO_ANSWER, lambda values: self._analog(0, values[0])),
            ([_ANALOG[1]], _IO_ANSWER, lambda values: self._analog(1, values[0])),
            (["gpio/tool_voltage_cmd"], _IO_ANSWER, lambda values: driver.set_tool_voltage(int(values[0]))),
            (
                ["speed_scaling/target_speed_fraction_cmd"],
                "speed_scaling/target_speed_fraction_async_success",
                lambda values: driver.set_speed_slider(values[0]),
            ),
            (
                ["resend_robot_program/resend_robot_program_cmd"],
                "resend_robot_program/resend_robot_program_async_success",
                lambda _: driver.start_program(),
            ),
            (
                ["hand_back_control/hand_back_control_cmd"],
                "hand_back_control/hand_back_control_async_success",
                lambda _: driver.stop_program(),
            ),
            (_PAYLOAD, "payload/payload_async_success", self._payload),
            (_GRAVITY, "gravity/gravity_async_success", driver.set_gravity),
            (_FRICTION, "friction_model/async_success", self._friction),
            (
                ["zero_ftsensor/zero_ftsensor_cmd"],
                "zero_ftsensor/zero_ftsensor_async_success",
                lambda _: driver.zero_ftsensor(),
            ),
            (FORCE_MODE_COMMANDS, _FORCE_ANSWER, self._start_force_mode),
            (["force_mode/disable_cmd"], _FORCE_ANSWER, lambda _: self._immediately(driver.end_force_mode)),
            (
                ["freedrive_mode/enable"],
                "freedrive_mode/async_success",
                lambda _: self._immediately(driver.start_freedrive),
            ),
            (
                ["freedrive_mode/abort"],
                "freedrive_mode/async_success",
                lambda _: self._immediately(driver.stop_freedrive),
            ),
        ]

    async def _answered(self, answer: str, work: Awaitable[None]) -> None:
        try:
            await work
        except URError as error:
            _logger.error("%s", error)
            self[answer] = FAILURE
        else:
            self[answer] = SUCCESS

    async def _immediately(self, action: Callable[[], None]) -> None:
        action()

    def _switch_outputs(self) -> None:
        levels = self._digital.get()
        wanted = [(digital_signal(pin), level) for pin, level in enumerate(levels) if level == level]
        if not wanted:
            return
        self._digital.fill(NO_COMMAND)
        lines = [f"  {group.statement(index, level != 0.0)}" for (group, index), level in wanted]
        self._spawn(self._answered(_IO_ANSWER, self._send_lines(lines)))

    async def _analog(self, pin: int, share: float) -> None:
        domain, self[_DOMAIN] = self[_DOMAIN], NO_COMMAND
        lines = [f"  set_analog_outputdomain({pin}, {int(domain)})"] if domain == domain else []
        await self._send_lines([*lines, f"  set_standard_analog_out({pin}, {share})"])

    async def _send_lines(self, lines: Sequence[str]) -> None:
        await self._driver.link.send_script("\n".join(["sec setting():", *lines, "end"]))

    async def _payload(self, values: list[float]) -> None:
        rest = self._inertia.take()
        if rest is None:
            await self._driver.set_payload(values[0], values[1:])
        else:
            await self._driver.set_target_payload(values[0], values[1:], rest[:6], rest[6])

    async def _friction(self, values: list[float]) -> None:
        self._driver.set_friction_scales(values[:6], values[6:])

    async def _start_force_mode(self, values: list[float]) -> None:
        frame, selection, wrench, limits = values[:6], values[6:12], values[12:18], values[19:25]
        self._driver.start_force_mode(
            frame,
            [int(axis) for axis in selection],
            wrench,
            int(values[18]),
            limits,
            damping=values[25],
            gain_scaling=values[26],
        )

    def _watch_contact(self) -> None:
        wanted = self._contact.take()
        if wanted is None:
            return
        if wanted[0] == ToolContactState.WAITING_BEGIN:
            self._begin_contact()
        elif wanted[0] == ToolContactState.WAITING_END:
            self._end_contact()
        else:
            self._set_contact(ToolContactState(int(wanted[0])))

    def _begin_contact(self) -> None:
        try:
            self._driver.start_tool_contact()
        except URError as error:
            _logger.error("%s", error)
            self._set_contact(ToolContactState.FAILURE_BEGIN)
            return
        self._states["tool_contact/tool_contact_result"] = _CONTACT_NONE
        self._set_contact(ToolContactState.EXECUTING)
        self._spawn(self._await_contact())

    async def _await_contact(self) -> None:
        try:
            result = await self._driver.tool_contact_result()
        except ClientError as error:
            _logger.error("%s", error)
            result = TrajectoryResult.CANCELED
        if result is TrajectoryResult.SUCCESS:
            self.contact = "the tool touched something"
        self._states["tool_contact/tool_contact_result"] = float(result)

    def _end_contact(self) -> None:
        try:
            self._driver.end_tool_contact()
        except URError as error:
            _logger.error("%s", error)
            self._set_contact(ToolContactState.FAILURE_END)
        else:
            self._set_contact(ToolContactState.SUCCESS_END)

    def _set_contact(self, state: ToolContactState) -> None:
        self._states["tool_contact/tool_contact_state"] = float(state)


def _names() -> tuple[str, ...]:
    points = ("setpoint_positions", "setpoint_velocities", "setpoint_accelerations")
    return (
        *_DIGITAL,
        *_ANALOG,
        _DOMAIN,
        "gpio/tool_voltage_cmd",
        _IO_ANSWER,
        "speed_scaling/target_speed_fraction_cmd",
        "speed_scaling/target_speed_fraction_async_success",
        "resend_robot_program/resend_robot_program_cmd",
        "resend_robot_program/resend_robot_program_async_success",
        "hand_back_control/hand_back_control_cmd",
        "hand_back_control/hand_back_control_async_success",
        *_PAYLOAD,
        *_INERTIA,
        "payload/payload_async_success",
        *_GRAVITY,
        "gravity/gravity_async_success",
        *_FRICTION,
        "friction_model/async_success",
        "zero_ftsensor/zero_ftsensor_cmd",
        "zero_ftsensor/zero_ftsensor_async_success",
        *FORCE_MODE_COMMANDS,
        _FORCE_ANSWER,
        "force_mode/disable_cmd",
        *(f"freedrive_mode/{name}" for name in ("enable", "abort", "async_success")),
        *(f"{PASSTHROUGH}/{part}_{joint}" for part in points for joint in range(len(JOINT_NAMES))),
        *(f"{PASSTHROUGH}/{name}" for name in ("abort", "transfer_state", "time_from_start", "trajectory_size")),
        *PRIMITIVE_COMMANDS,
        "tool_contact/tool_contact_set_state",
    )
