"""``/diagnostics``, once a second: controllers, hardware, and whether the control cycle keeps its rate.

Source of names, keys, texts and thresholds: controller_manager of Jazzy. The rate is measured by the robot's clock,
because every state of the robot should have a cycle. The execution time of controllers is not measured.
"""

import statistics
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from client.controllers.controller import LifecycleState
from client.ros2.control_side import SIDE, ControlSide, RobotFacts
from client.ros2.host import NodeHost, stamp

_PERIOD_S: Final = 1.0  # diagnostic_updater
_WARN_HZ: Final = (
    5.0  # defaults of diagnostics.threshold.controller_manager.periodicity: mean_error, standard_deviation
)
_ERROR_HZ: Final = 10.0
_HARDWARE_ID: Final = "ros2_control"

Values = Sequence[tuple[str, str]]


class Diagnostics:
    """Publishes the state of a controller manager through its node."""

    def __init__(self, host: NodeHost, node: Node, facts: RobotFacts) -> None:
        self._host = host
        self._node = node
        self._facts = facts
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 1)
        node.create_timer(_PERIOD_S, self._publish)

    def _publish(self) -> None:
        controllers, component = self._host.do(ControlSide.states, SIDE)
        times_s = self._host.do(ControlSide.take_cycle_times, SIDE)
        message = DiagnosticArray(
            status=[self._controllers(controllers, component), self._hardware(component), self._cycle(times_s)]
        )
        stamp(message.header.stamp, self._host.now_ns())
        self._publisher.publish(message)

    def _controllers(self, controllers: Values, component: str) -> DiagnosticStatus:
        if component != LifecycleState.ACTIVE:
            level, text = DiagnosticStatus.ERROR, "No hardware components are currently active to activate controllers"
        elif not controllers:
            level, text = DiagnosticStatus.WARN, "No controllers are currently loaded"
        elif all(state == LifecycleState.ACTIVE for _, state in controllers):
            level, text = DiagnosticStatus.OK, "All controllers are active"
        else:
            level, text = DiagnosticStatus.OK, "Not all controllers are active"
        states = [(f"{name}.state", state) for name, state in controllers]
        return _status("Controllers Activity", level, text, states)

    def _hardware(self, component: str) -> DiagnosticStatus:
        if component == LifecycleState.ACTIVE:
            level, text = DiagnosticStatus.OK, "All hardware components are active"
        else:
            level, text = DiagnosticStatus.WARN, "No hardware components are currently active"
        return _status("Hardware Components Activity", level, text, [(f"{self._facts.component}.state", component)])

    def _cycle(self, times_s: Sequence[float]) -> DiagnosticStatus:
        wanted_hz = self._facts.update_rate_hz
        rates_hz = [1.0 / (after - before) for before, after in pairwise(times_s) if after > before] or [0.0]
        average_hz, deviation_hz = statistics.fmean(rates_hz), statistics.pstdev(rates_hz)
        values = [
            ("update_rate", f"{wanted_hz:.0f}"),
            ("periodicity.average", f"{average_hz:.6f}"),
            ("periodicity.standard_deviation", f"{deviation_hz:.6f}"),
            ("periodicity.min", f"{min(rates_hz):.6f}"),
            ("periodicity.max", f"{max(rates_hz):.6f}"),
        ]
        error_hz = max(abs(average_hz - wanted_hz), deviation_hz)
        level, text = DiagnosticStatus.OK, "Controller Manager is running"
        if error_hz > _WARN_HZ:
            level = DiagnosticStatus.ERROR if error_hz > _ERROR_HZ else DiagnosticStatus.WARN
            text = (
                f"Controller Manager has bad periodicity : {average_hz:.6g} Hz. Expected consistent {wanted_hz:.0f} Hz"
            )
        return _status("Controller Manager Activity", level, text, values)


def _status(name: str, level: Any, message: str, values: Values) -> DiagnosticStatus:
    return DiagnosticStatus(
        level=level,
        name=f"controller_manager: {name}",
        message=message,
        hardware_id=_HARDWARE_ID,
        values=[KeyValue(key=key, value=value) for key, value in values],
    )
