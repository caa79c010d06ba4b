"""The inputs and outputs of the safety system, and devices that are wired to them or not."""

from collections.abc import Mapping
from enum import Enum, auto
from functools import reduce
from math import remainder, tau
from operator import or_
from typing import Final

from emulator.io.signals import Signals
from emulator.machine import Machine
from urproto.modes import SafetyMode
from urproto.signals import CONFIGURABLE
from urproto.vectors import Vector6
from urscript.polyscope.safety_configuration import Pins, SafetyConfiguration, SafetyInput, SafetyOutput

_MOVING_RAD_S: Final = 0.1  # user manual: output "robot moving"
_HOME_RAD: Final = 0.0297  # 1.7 degrees: e-Series manual, safe home


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
        self._all = reduce(or_, self._masks.values(), 0)
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
        """Press, open or release a device; takes effect in this period."""
        (self._active.add if active else self._active.discard)(device)
        self._seen, self._rising = -1, frozenset()

    def active(self, device: SafetyDevice) -> bool:
        """Whether the device is active, or the input of its function is low."""
        function = _BY_INPUT.get(device)
        return device in self._active or (function in self._masks and function not in self._high)

    def assigned(self, function: SafetyInput) -> bool:
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


def output_levels(machine: Machine, home: Vector6 | None) -> dict[SafetyOutput, bool]:
    """Levels of the safety outputs (user manual): low is the safe level; after a violation or fault, all are low.

    home: the joint angles of the safe home position [rad].
    """
    safety = machine.safety
    if safety.mode in (SafetyMode.VIOLATION, SafetyMode.FAULT):
        return dict.fromkeys(SafetyOutput, False)
    reduced = safety.mode is SafetyMode.REDUCED
    return {
        SafetyOutput.SYSTEM_EMERGENCY_STOP: safety.mode is not SafetyMode.ROBOT_EMERGENCY_STOP,
        SafetyOutput.ROBOT_MOVING: max(map(abs, machine.arm.qd)) <= _MOVING_RAD_S,
        SafetyOutput.ROBOT_NOT_STOPPING: safety.stopped,
        SafetyOutput.REDUCED_MODE: not reduced,
        SafetyOutput.NOT_REDUCED_MODE: reduced,
        SafetyOutput.SAFE_HOME: home is not None and machine.power.report.powered and _is_at(machine.arm.q, home),
    }


def _is_at(q: Vector6, home: Vector6) -> bool:
    return all(abs(remainder(a - b, tau)) <= _HOME_RAD for a, b in zip(q, home, strict=True))
