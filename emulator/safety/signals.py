"""Safety inputs and outputs: which function reads or drives which configurable pin, and what else asks for it.

Signals have two channels and are safe when low: either channel counts. What is wired counts as healthy at the start:
pins of functions that stop the arm when low begin high.
"""

from collections.abc import Mapping
from enum import Enum, auto
from typing import Final

from emulator.io.signals import CONFIGURABLE, Signals
from emulator.safety.configuration import Pins, SafetyConfiguration, SafetyInput, SafetyOutput

__all__ = ["SafetyDevice", "SafetyInputs", "drive_outputs"]


class SafetyDevice(Enum):
    """What a user can press, open or release, wired or not."""

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
    """Levels of the inputs, and the devices that are active beside them."""

    def __init__(self, configuration: SafetyConfiguration, signals: Signals) -> None:
        self._signals = signals
        self._masks = {function: _mask(pins) for function, pins in configuration.inputs.items()}
        self._all = _union(self._masks)
        self._seen = -1
        self._high: frozenset[SafetyInput] = frozenset()
        self._active: set[SafetyDevice] = set()
        self._rising: frozenset[SafetyInput] = frozenset()
        for function in _BY_INPUT.values():
            signals.digital_inputs |= self._masks.get(function, 0)

    def latch(self) -> bool:
        """Look at the pins; True when anything is not as it was at the last look."""
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
        """The device is active, or the input of its function is low."""
        function = _BY_INPUT.get(device)
        return device in self._active or (function in self._masks and function not in self._high)

    def assigned(self, function: SafetyInput) -> bool:
        """The function has pins."""
        return function in self._masks

    def high(self, function: SafetyInput) -> bool:
        """Both channels are high."""
        return function in self._high

    def rose(self, function: SafetyInput) -> bool:
        """Both channels are high, and were not at the last look."""
        return function in self._rising

    def pins_of(self, function: SafetyInput) -> int:
        """Mask of its bits in the word of digital inputs; 0 when it has none."""
        return self._masks.get(function, 0)


def drive_outputs(signals: Signals, pins: Mapping[SafetyOutput, Pins], levels: Mapping[SafetyOutput, bool]) -> None:
    """Set the pins of the assigned functions; nobody else can."""
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
