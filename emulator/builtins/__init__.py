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

_CHAPTERS: Final = (
    *(motion, compliance, pathoffset, conveyor, state, kinematics, setup, io, ioconfig, registers),
    *(sockets, rpc, modbus, messages, flow, interpreter, tuning, baselight, worldmodel, refused),
)
LIBRARIES: Final[list[Library]] = [*PURE_LIBRARIES, *(chapter.LIBRARY for chapter in _CHAPTERS)]
