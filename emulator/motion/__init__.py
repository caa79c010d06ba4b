"""Motion generators: from movement commands to a target joint configuration each control period.

`Motion` has one method a script function; the movements themselves are generators, one family a module. The package
knows no program, no power and no network, and reads no clock.
"""

from emulator.motion.faults import MotionFault
from emulator.motion.motion import Motion
from emulator.motion.stepping import Move

__all__ = ["Motion", "MotionFault", "Move"]
