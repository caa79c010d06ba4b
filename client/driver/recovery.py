"""Protective stops: noticed, unlocked when the robot allows it, and the program started again."""

import asyncio
import logging
from collections.abc import Callable, Mapping
from typing import Any, Final

from client import dashboard
from client.driver.config import DriverConfig
from client.driver.core import MOVABLE, DriverCore
from urproto.errors import RobotRefused
from urproto.modes import SafetyMode

__all__ = ["Recovery"]

_LOCKED_S: Final = 5.0  # dashboard manual: it cannot be unlocked for 5 s after it occurred
_SPARE_S: Final = 0.2  # guess: the state that showed it may have been late
_UNLOCK_LINE: Final = "set unlock protective stop"
_UNLOCK_TIMEOUT_S: Final = 5.0

_logger = logging.getLogger(__name__)


class Recovery(DriverCore):
    """Watches the safety mode."""

    def __init__(self, config: DriverConfig) -> None:
        super().__init__(config)
        self._safety_mode: SafetyMode | None = None
        self._stopped_at_s: float | None = None
        self.robot.on_modes.append(self._note)

    def on_safety_mode(self, callback: Callable[[SafetyMode], None]) -> None:
        """Call back with each new safety mode."""
        before: list[SafetyMode] = [self.robot.safety_mode]

        def changed(_: Mapping[str, Any]) -> None:
            if self.robot.safety_mode != before[0]:
                before[0] = self.robot.safety_mode
                callback(before[0])

        self.robot.on_modes.append(changed)

    @property
    def protective_stopped(self) -> bool:
        """True during a protective stop."""
        return self.robot.safety_mode is SafetyMode.PROTECTIVE_STOP

    async def recover(self) -> None:
        """Unlock a protective stop, 5 s after it occurred, and start the control program again.

        For a caller who knows why the arm stopped and that it may move again. Raises RobotRefused
        when something else than a protective stop is the matter, or it comes back at once.
        """
        if self.protective_stopped:
            await self._unlock()
        await self.start_program()

    async def _unlock(self) -> None:
        since = self._stopped_at_s if self._stopped_at_s is not None else self.state["timestamp"]
        while self.state["timestamp"] < since + _LOCKED_S + _SPARE_S:
            await self.next_state()
        if self.robot.dashboard is not None:
            await self.robot.dashboard.ask(dashboard.UNLOCK_PROTECTIVE_STOP)
        else:
            await self.robot.send_script(_UNLOCK_LINE)
        try:
            async with asyncio.timeout(_UNLOCK_TIMEOUT_S):
                while self.robot.safety_mode not in MOVABLE:
                    await self.next_state()
        except TimeoutError:
            mode = self.robot.safety_mode.name
            raise RobotRefused("unlock protective stop", f"it stays in {mode}: remove the cause first") from None

    def _note(self, state: Mapping[str, Any]) -> None:
        mode = self.robot.safety_mode
        if mode == self._safety_mode:
            return
        self._safety_mode = mode
        if mode is SafetyMode.PROTECTIVE_STOP:
            self._stopped_at_s = state["timestamp"]
            _logger.warning("protective stop")
