"""Command modes of the hardware, and which of them can be combined.

Source: the mode compatibilities of the hardware interface in Universal_Robots_ROS2_Driver.
"""

from collections.abc import Iterable
from typing import Final

from urproto.compat import StrEnum


class CommandMode(StrEnum):
    """Ways to command the arm; all joints are in the same one."""

    POSITION = "position"
    VELOCITY = "velocity"
    EFFORT = "effort"
    FORCE_MODE = "force_mode"
    PASSTHROUGH = "trajectory_passthrough"
    FREEDRIVE = "freedrive_mode"
    TOOL_CONTACT = "tool_contact"
    MOTION_PRIMITIVE = "motion_primitive"


MOTION: Final = frozenset(
    [
        CommandMode.POSITION,
        CommandMode.VELOCITY,
        CommandMode.EFFORT,
        CommandMode.PASSTHROUGH,
        CommandMode.FREEDRIVE,
        CommandMode.MOTION_PRIMITIVE,
    ]
)
"""Modes that move the arm; the others modify its motion."""

_TOGETHER: Final = frozenset(
    [
        *(
            frozenset([CommandMode.FORCE_MODE, mode])
            for mode in (CommandMode.PASSTHROUGH, CommandMode.MOTION_PRIMITIVE)
        ),
        *(frozenset([CommandMode.TOOL_CONTACT, mode]) for mode in MOTION - {CommandMode.FREEDRIVE}),
    ]
)


def mode_of(interface: str, prefix: str) -> CommandMode | None:
    """The mode that a command interface belongs to; None for inputs, outputs, payload and other settings."""
    component, _, kind = interface.rpartition("/")
    if component.endswith("_joint"):
        return CommandMode(kind)
    name = component.removeprefix(prefix)
    return CommandMode(name) if name in _COMPONENTS else None


_COMPONENTS: Final = frozenset(CommandMode) - {CommandMode.POSITION, CommandMode.VELOCITY, CommandMode.EFFORT}


def conflict(modes: Iterable[CommandMode]) -> tuple[CommandMode, CommandMode] | None:
    """Two of the modes that exclude each other; None if all can be combined."""
    chosen = sorted(set(modes))
    for place, one in enumerate(chosen):
        for other in chosen[place + 1 :]:
            if frozenset([one, other]) not in _TOGETHER:
                return one, other
    return None
