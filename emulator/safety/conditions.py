"""Lasting conditions of inputs, devices and the arm's position; each causes a safety mode while it is present."""

from typing import Final

from emulator.lifecycle.safety import SafetyEvent
from emulator.machine import Machine
from emulator.safety.geometry import Boundaries
from emulator.safety.signals import SafetyDevice, SafetyInputs
from emulator.safety.supervision import Supervision
from urproto.modes import SafetyMode
from urproto.versions import Series
from urscript.polyscope.safety_configuration import SafetyConfiguration, SafetyInput

_TRIGGER_HYSTERESIS_M: Final = 0.02  # hardware manuals: both sets of limits are accepted within this distance
_EMERGENCY_STOPS: Final = frozenset({SafetyEvent.ROBOT_EMERGENCY_STOP, SafetyEvent.SYSTEM_EMERGENCY_STOP})


class Conditions:
    """The lasting conditions. raised: start events of those that are present."""

    def __init__(
        self,
        machine: Machine,
        configuration: SafetyConfiguration,
        inputs: SafetyInputs,
        boundaries: Boundaries,
        supervision: Supervision,
    ) -> None:
        self._machine = machine
        self._configuration = configuration
        self._inputs = inputs
        self._boundaries = boundaries
        self._supervision = supervision
        self._beyond_trigger = False
        self.raised: set[SafetyEvent] = set()

    def use(self, configuration: SafetyConfiguration, boundaries: Boundaries) -> None:
        """Apply another configuration; the arm's position is checked against it when the arm is powered on."""
        self._configuration, self._boundaries = configuration, boundaries
        self._beyond_trigger = False
        self._hold((SafetyEvent.OUTSIDE_LIMITS, SafetyEvent.INSIDE_LIMITS), False)

    def follow_inputs(self) -> None:
        """Inputs, devices or the operational mode have changed."""
        inputs, mode = self._inputs, self._machine.operational_mode
        e_series = self._machine.model.series is Series.E
        self._emergency_stops()
        self._safeguard(
            (SafetyEvent.SAFEGUARD_OPEN, SafetyEvent.SAFEGUARD_CLOSED),
            inputs.active(SafetyDevice.SAFEGUARD),
            SafetyInput.SAFEGUARD_RESET,
        )
        self._safeguard(
            (SafetyEvent.AUTOMATIC_SAFEGUARD_OPEN, SafetyEvent.AUTOMATIC_SAFEGUARD_CLOSED),
            inputs.active(SafetyDevice.AUTOMATIC_SAFEGUARD) and mode == "AUTOMATIC" and e_series,
            SafetyInput.AUTOMATIC_SAFEGUARD_RESET,
        )
        self._hold(
            (SafetyEvent.ENABLING_RELEASED, SafetyEvent.ENABLING_HELD),
            inputs.active(SafetyDevice.ENABLING_DEVICE) and mode == "MANUAL" and e_series,
        )
        self._follow_reduced()

    def _emergency_stops(self) -> None:
        """Follow the emergency stops. The robot's takes precedence; if one is released, the other stays active."""
        held = [
            event
            for event, device in (
                (SafetyEvent.ROBOT_EMERGENCY_STOP, SafetyDevice.EMERGENCY_STOP),
                (SafetyEvent.SYSTEM_EMERGENCY_STOP, SafetyDevice.SYSTEM_EMERGENCY_STOP),
            )
            if self._inputs.active(device)
        ]
        before = self.raised & _EMERGENCY_STOPS
        if set(held) == before:
            return
        self.raised = self.raised - _EMERGENCY_STOPS | set(held)
        if before - set(held):
            self._machine.safety_event(SafetyEvent.EMERGENCY_STOP_RELEASED)
        for event in held:
            self._machine.safety_event(event)

    def _safeguard(self, events: tuple[SafetyEvent, SafetyEvent], opened: bool, reset: SafetyInput) -> None:
        """Follow a safeguard. With a reset input, it stays open until that rises while the safeguard is closed."""
        waits = self._inputs.assigned(reset) and not self._inputs.rose(reset)
        self._hold(events, opened or (events[0] in self.raised and waits))

    def _hold(self, events: tuple[SafetyEvent, SafetyEvent], wanted: bool) -> None:
        """Raise or end a condition, given by its start and end events."""
        begun, ended = events
        if wanted is (begun in self.raised):
            return
        (self.raised.add if wanted else self.raised.discard)(begun)
        self._machine.safety_event(begun if wanted else ended)

    def _follow_reduced(self) -> None:
        """Keep reduced mode as long as an input or a trigger plane requires it."""
        wanted = self._inputs.active(SafetyDevice.REDUCED_MODE) or self._beyond_trigger
        self._hold((SafetyEvent.REDUCED, SafetyEvent.NOT_REDUCED), wanted)

    def follow_triggers(self) -> None:
        """Check on which side of the trigger planes for reduced mode the arm is."""
        hysteresis = -_TRIGGER_HYSTERESIS_M if self._beyond_trigger else 0.0
        self._beyond_trigger = self._boundaries.beyond_trigger(self._machine.arm, hysteresis)
        self._follow_reduced()

    def check_position(self) -> None:
        """Check the arm's position: outside the limits of normal or reduced mode, it can only be moved back."""
        reduced = SafetyEvent.REDUCED in self.raised
        limits = self._configuration.reduced if reduced else self._configuration.normal
        mode = SafetyMode.REDUCED if reduced else SafetyMode.NORMAL
        outside = self._supervision.outside(self._machine.arm, limits, self._boundaries, mode)
        self._hold((SafetyEvent.OUTSIDE_LIMITS, SafetyEvent.INSIDE_LIMITS), outside)
