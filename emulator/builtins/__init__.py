"""All functions a URScript program can call on this controller: a library for each chapter of the list of built-ins."""

from typing import Final

from emulator.builtins import (
    baselight,
    compliance,
    conveyor,
    flow,
    interpreter,
    io,
    ioconfig,
    kinematics,
    messages,
    modbus,
    motion,
    pathoffset,
    refused,
    registers,
    rpc,
    setup,
    sockets,
    state,
    tuning,
    worldmodel,
)
from urscript.builtins import Library
from urscript.library import LIBRARIES as PURE_LIBRARIES

__all__ = ["LIBRARIES"]

LIBRARIES: Final[list[Library]] = [
    *PURE_LIBRARIES,
    motion.LIBRARY,
    compliance.LIBRARY,
    pathoffset.LIBRARY,
    conveyor.LIBRARY,
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
    interpreter.LIBRARY,
    tuning.LIBRARY,
    baselight.LIBRARY,
    worldmodel.LIBRARY,
    refused.LIBRARY,
]
