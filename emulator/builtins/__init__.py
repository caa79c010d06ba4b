"""Every function a URScript program can call on this controller, one library a chapter."""

from typing import Final

from emulator.builtins import (
    compliance,
    flow,
    io,
    ioconfig,
    kinematics,
    messages,
    modbus,
    motion,
    refused,
    registers,
    rpc,
    setup,
    sockets,
    state,
)
from urscript.builtins import Library
from urscript.library import LIBRARIES as PURE_LIBRARIES

__all__ = ["LIBRARIES"]

LIBRARIES: Final[list[Library]] = [
    *PURE_LIBRARIES,
    motion.LIBRARY,
    compliance.LIBRARY,
    state.LIBRARY,
    kinematics.LIBRARY,
    setup.LIBRARY,
    io.LIBRARY,
    ioconfig.LIBRARY,
    registers.LIBRARY,
    sockets.LIBRARY,
    rpc.LIBRARY,
    modbus.LIBRARY,
    messages.LIBRARY,
    flow.LIBRARY,
    refused.LIBRARY,
]
