"""Lasting conditions of inputs, devices and the arm's position; each causes a safety mode while it is present."""

from collections.abc import Mapping
from enum import Enum, auto
from typing import Final

from emulator.io.signals import Signals
from emulator.lifecycle.safety import SafetyEvent
from emulator.machine import Machine
from emulator.safety.geometry import Boundaries
from emulator.safety.supervision import Supervision
from urproto.modes import SafetyMode
from urproto.signals import CONFIGURABLE
from urproto.versions import Series
from urscript.polyscope.safety_configuration import Pins, SafetyConfiguration, SafetyInput, SafetyOutput

_TRIGGER_HYSTERESIS_M: Final = 0.02  # hardware manuals: both sets of limits are accepted within this distance
_EMERGENCY_STOPS: Final = frozenset({SafetyEvent.ROBOT_EMERGENCY_STOP, SafetyEvent.SYSTEM_EMERGENCY_STOP})


class SafetyDevice(Enum):
    """Devices that a user can press, open or release, wired or not."""

    EMERGENCY_STOP = auto()  # the pendant's button, or the robot emergency stop input
    SYSTEM_EMERGENCY_STOP = auto()  # another machine's
    SAFEGUARD = auto()  # the dedicated safeguard input
    AUTOMATIC_SAFEGUARD = auto()
    ENABLING_DEVICE = auto()  # active: not in its middle position
    REDUCED_MODE = auto()


_BY_INPUT: Final = {
    SafetyDevice.SYSTEM_EMERGENCY_STOP: SafetyInput.EMERGENCY_STOP,
    SafetyDevice.AUTOMATIC_SAFEGUARD: SafetyInput.AUTOMATIC_SAFEGUARD,
    SafetyDevice.ENABLING_DEVICE: SafetyInput.ENABLING_DEVICE,
    SafetyDevice.REDUCED_MODE: SafetyInput.REDUCED_MODE,
}


class SafetyInputs:
    """Levels of the safety inputs, and devices that are active independently of them."""

    def __init__(self, configuration: SafetyConfiguration, signals: Signals) -> None:
        self._signals = signals
        self._active: set[SafetyDevice] = set()
        self._high: frozenset[SafetyInput] = frozenset()
        self._rising: frozenset[SafetyInput] = frozenset()
        self.assign(configuration)

    def assign(self, configuration: SafetyConfiguration) -> None:
        """Assign functions to the inputs. Devices wired to them are taken to be at rest, that is high."""
        self._masks = {function: _mask(pins) for function, pins in configuration.inputs.items()}
        self._all = _union(self._masks)
        self._seen = -1
        for function in _BY_INPUT.values():
            self._signals.digital_inputs |= self._masks.get(function, 0)

    def latch(self) -> bool:
        """Read the pins; returns True if anything has changed since the last call."""
        word = self._signals.digital_inputs & self._all
        if word == self._seen:
            return False
        before, first = self._high, self._seen < 0
        self._seen = word
        self._high = frozenset(function for function, mask in self._masks.items() if word & mask == mask)
        self._rising = frozenset() if first else self._high - before
        return True

    def set_device(self, device: SafetyDevice, active: bool) -> None:
        """Press or open, release or close."""
        (self._active.add if active else self._active.discard)(device)
        self._seen, self._rising = -1, frozenset()

    def active(self, device: SafetyDevice) -> bool:
        """Whether the device is active, or the input of its function is low."""
        function = _BY_INPUT.get(device)
        return device in self._active or (function in self._masks and function not in self._high)

    def assigned(self, function: SafetyInput) -> bool:
        """Whether the function has pins."""
        return function in self._masks

    def high(self, function: SafetyInput) -> bool:
        """Whether both channels are high."""
        return function in self._high

    def rose(self, function: SafetyInput) -> bool:
        """Whether both channels are high and were not at the last `latch`."""
        return function in self._rising

    def pins_of(self, function: SafetyInput) -> int:
        """Mask of its bits in the word of digital inputs; 0 when it has none."""
        return self._masks.get(function, 0)


def drive_outputs(signals: Signals, pins: Mapping[SafetyOutput, Pins], levels: Mapping[SafetyOutput, bool]) -> None:
    """Set the pins of the assigned functions; this overrides programs and clients."""
    word = signals.digital_outputs
    for function, pair in pins.items():
        mask = _mask(pair)
        word = word | mask if levels[function] else word & ~mask
    signals.digital_outputs = word


def _mask(pins: Pins) -> int:
    return sum(1 << CONFIGURABLE.bit(pin) for pin in set(pins))


def _union(masks: Mapping[SafetyInput, int]) -> int:
    whole = 0
    for mask in masks.values():
        whole |= mask
    return whole


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
