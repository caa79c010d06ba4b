"""The reverse interface (50001): setpoints and keep-alives to the control program."""

from collections.abc import Sequence
from typing import Final

from client.driver.endpoint import Endpoint
from client.driver.timeouts import KEEP_ALIVE_TIMEOUT_S, LONGEST_REAL_TIME_S, SETPOINT_TIMEOUT_S, read_timeout_ms
from urproto.external_control import ControlMode, FreedriveAction, ReverseMessage, TrajectoryAction
from urproto.versions import Series

__all__ = ["REVERSE_PORT", "ReverseEndpoint"]

REVERSE_PORT: Final = 50001


class ReverseEndpoint(Endpoint):
    """Sends what the arm is to do; while a robot is connected here its program runs.

    period_s: the robot's control period [s]. Every method sends at once, and raises
    ProgramNotRunningError without a robot and LocalProtocolError for values that cannot be
    sent. timeout_s: how long the program waits for the message after this one before it stops
    the arm and ends; see `read_timeout_ms` for its limits.
    """

    def __init__(self, port: int = REVERSE_PORT, host: str = "", period_s: float = Series.E.period_s) -> None:
        super().__init__(port, host)
        self.period_s = period_s
        self.mode = ControlMode.IDLE

    def setpoint(self, mode: ControlMode, values: Sequence[float], timeout_s: float = SETPOINT_TIMEOUT_S) -> None:
        """One setpoint (6,) of a real-time mode, in the units `ReverseMessage.setpoint` gives."""
        self._send(ReverseMessage.setpoint(mode, values, self._timeout_ms(mode, timeout_s)))

    def keep_alive(self, timeout_s: float = KEEP_ALIVE_TIMEOUT_S) -> None:
        """Nothing to do: an arm in motion is brought to rest."""
        self._send(ReverseMessage.keep_alive(self._timeout_ms(ControlMode.IDLE, timeout_s)))

    def trajectory(self, action: TrajectoryAction, points: int = 0, timeout_s: float = LONGEST_REAL_TIME_S) -> None:
        """Start, keep alive, or end a trajectory of so many points."""
        self._send(ReverseMessage.trajectory(action, points, self._timeout_ms(ControlMode.FORWARD, timeout_s)))

    def freedrive(self, action: FreedriveAction, timeout_s: float = LONGEST_REAL_TIME_S) -> None:
        """Start, keep alive, or end freedrive."""
        self._send(ReverseMessage.freedrive(action, self._timeout_ms(ControlMode.FREEDRIVE, timeout_s)))

    def stop(self) -> None:
        """End the control program."""
        self._send(ReverseMessage.stop())

    def continue_mode(self, timeout_s: float = KEEP_ALIVE_TIMEOUT_S) -> None:
        """The keep-alive of the present mode. Real-time modes have none: only setpoints keep them alive."""
        if self.mode is ControlMode.FORWARD:
            self.trajectory(TrajectoryAction.NOOP, 0, timeout_s)
        elif self.mode is ControlMode.FREEDRIVE:
            self.freedrive(FreedriveAction.NOOP, timeout_s)
        elif self.mode is ControlMode.IDLE:
            self.keep_alive(timeout_s)

    def _timeout_ms(self, mode: ControlMode, timeout_s: float) -> int:
        return read_timeout_ms(mode, timeout_s, self.period_s)

    def _send(self, message: ReverseMessage) -> None:
        self.peer.write(message.encode())
        self.mode = message.mode

    def _tell(self, connected: bool) -> None:
        self.mode = ControlMode.IDLE
        super()._tell(connected)
