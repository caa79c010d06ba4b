"""Motion generators: from movement commands to a target joint configuration each control period.

`Motion` is the interface to the rest of the emulator and describes its parts; `MotionCommands` has one method per
script function. The movements themselves are generators, one family per module. The package knows nothing about
programs, power or networks, and reads no clock.
"""

from emulator.motion.commands import MotionCommands
from emulator.motion.faults import MotionFault
from emulator.motion.motion import Motion
from emulator.motion.movement import Move

__all__ = ["Motion", "MotionCommands", "MotionFault", "Move"]
