"""The light ring in the base of the large arms."""

from dataclasses import dataclass
from typing import Final, Literal

__all__ = ["ARMS_WITH_BASE_LIGHT", "BaseLight"]

ARMS_WITH_BASE_LIGHT: Final = ("ur20", "ur30")  # Script Manual, set_baselight_solid


@dataclass(frozen=True, slots=True)
class BaseLight:
    """``mode``: "iec" shows the state of the arm in the colours of IEC 60204-1 (how it begins is a guess), "solid"
    the ``colour`` (red, green, blue, each 0 to 255), "off" nothing."""

    mode: Literal["iec", "solid", "off"] = "iec"
    colour: tuple[int, int, int] | None = None
