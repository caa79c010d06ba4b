"""Digital signals: three groups that share a word of 18 bits in each direction, on every interface."""

from dataclasses import dataclass
from typing import Final

SIGNALS: Final = 18
"""Digital signals of one direction: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool."""


@dataclass(frozen=True, slots=True)
class DigitalGroup:
    """Consecutive bits in the digital words: ``count`` from bit ``first`` on. letter: as in DI0."""

    name: str
    letter: str
    first: int
    count: int

    def bit(self, index: int) -> int:
        """Position of signal ``index`` in the word. Raises IndexError outside the group."""
        if not 0 <= index < self.count:
            raise IndexError(f"there is no {self.name} digital signal {index}: use 0 to {self.count - 1}")
        return self.first + index

    def statement(self, index: int, level: bool) -> str:
        """The URScript statement that sets an output."""
        return f"set_{self.name}_digital_out({index}, {bool(level)})"


STANDARD: Final = DigitalGroup("standard", "D", 0, 8)
CONFIGURABLE: Final = DigitalGroup("configurable", "C", 8, 8)
TOOL: Final = DigitalGroup("tool", "T", 16, 2)

DIGITAL_GROUPS: Final = (STANDARD, CONFIGURABLE, TOOL)
"""The groups in the order of their bits: standard and configurable signals of the control box, signals at the tool."""


def digital_signal(number: int) -> tuple[DigitalGroup, int]:
    """The group of the signal with this bit, and its index there. Raises IndexError if there is none."""
    for group in DIGITAL_GROUPS:
        if group.first <= number < group.first + group.count:
            return group, number - group.first
    raise IndexError(f"there is no digital signal {number}: 0-7 standard, 8-15 configurable, 16-17 tool")
