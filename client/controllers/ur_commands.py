"""The command interfaces of a Universal Robots arm, and how the driver carries out those that are not motions."""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from typing import Any, Final

from client.controllers.calls import FAILURE, SUCCESS
from client.controllers.compliance import FORCE_MODE_ANSWER, FORCE_MODE_COMMANDS, ToolContactState
from client.controllers.controller import NO_COMMAND
from client.controllers.io_and_status import (
    ANALOG,
    DIGITAL,
    DOMAIN,
    GPIO_COMMANDS,
    INERTIA,
    IO_ANSWER,
    PAYLOAD,
    TRIGGERS,
    FrictionModelController,
    GravityUpdateController,
)
from client.controllers.motion_primitives import PRIMITIVE_COMMANDS
from client.controllers.passthrough import PASSTHROUGH_COMMANDS
from client.controllers.ur_states import PrefixedInterfaces, URStates
from client.driver import URDriver
from client.errors import ClientError
from urproto.errors import URError
from urproto.external_control import TrajectoryResult
from urproto.signals import digital_signal

_NAMES: Final = (
    *GPIO_COMMANDS,
    *(*GravityUpdateController.names, GravityUpdateController.answer),
    *(*FrictionModelController.names, FrictionModelController.answer),
    *(*FORCE_MODE_COMMANDS, FORCE_MODE_ANSWER, "force_mode/disable_cmd"),
    *("freedrive_mode/enable", "freedrive_mode/abort", "freedrive_mode/async_success"),
    *PASSTHROUGH_COMMANDS,
    *PRIMITIVE_COMMANDS,
    "tool_contact/tool_contact_set_state",
)
_CONTACT_NONE: Final = 3.0  # result while the robot is still watching for contact

_logger = logging.getLogger(__name__)

Spawn = Callable[[Coroutine[Any, Any, None]], "asyncio.Task[None]"]
"""Runs a coroutine in the background of the control cycle."""


class URCommands(PrefixedInterfaces):
    """The command interfaces; `process` carries out one-time commands set on them."""

    def __init__(self, prefix: str, driver: URDriver, states: URStates, spawn: Spawn) -> None:
        super().__init__(prefix, _NAMES)
        self._driver = driver
        self._states = states
        self._spawn = spawn
        self.contact: str | None = None  # what stopped the arm
        self._digital = self.part(DIGITAL)
        self._contact = self.part(["tool_contact/tool_contact_set_state"])
        self._inertia = self.part(INERTIA)
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
            refused.add(IO_ANSWER)
        for answer in refused:
            _logger.error("%s", reason)
            self[answer] = FAILURE
        if refused:
            for left in (self._digital, self._inertia, self.part([DOMAIN])):
                left.fill(NO_COMMAND)

    def _table(self) -> list[tuple[Sequence[str], str, Callable[[list[float]], Awaitable[None]]]]:
        driver = self._driver
        return [
            ([ANALOG[0]], IO_ANSWER, lambda values: self._analog(0, values[0])),
            ([ANALOG[1]], IO_ANSWER, lambda values: self._analog(1, values[0])),
            (["gpio/tool_voltage_cmd"], IO_ANSWER, lambda values: driver.set_tool_voltage(int(values[0]))),
            (
                ["speed_scaling/target_speed_fraction_cmd"],
                "speed_scaling/target_speed_fraction_async_success",
                lambda values: driver.set_speed_slider(values[0]),
            ),
            (PAYLOAD, "payload/payload_async_success", self._payload),
            (GravityUpdateController.names, GravityUpdateController.answer, driver.set_gravity),
            (FrictionModelController.names, FrictionModelController.answer, self._friction),
            *(
                ([f"{name}/{name}_cmd"], f"{name}/{name}_async_success", lambda _, work=work: work())
                for name, work in zip(
                    TRIGGERS, (driver.start_program, driver.stop_program, driver.zero_ftsensor), strict=True
                )
            ),
            (FORCE_MODE_COMMANDS, FORCE_MODE_ANSWER, self._start_force_mode),
            (["force_mode/disable_cmd"], FORCE_MODE_ANSWER, lambda _: self._immediately(driver.end_force_mode)),
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
        self._spawn(self._answered(IO_ANSWER, self._send_lines(lines)))

    async def _analog(self, pin: int, share: float) -> None:
        domain, self[DOMAIN] = self[DOMAIN], NO_COMMAND
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
