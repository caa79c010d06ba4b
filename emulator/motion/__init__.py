"""Motion generators: from movement commands to a target joint configuration each control period.

`Motion` is the face for the rest of the emulator, and says what its parts are; `MotionCommands` has one method a script
function. The movements themselves are generators, one family a module. The package knows no program, no power and no
network, and reads no clock.
"""

from emulator.motion.commands import MotionCommands
from emulator.motion.faults import MotionFault
from emulator.motion.motion import Motion
from emulator.motion.movement import Move

__all__ = ["Motion", "MotionCommands", "MotionFault", "Move"]
