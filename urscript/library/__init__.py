"""The built-ins that need no robot."""

from urscript.builtins import Library
from urscript.library import checks, lists, math, poses, strings, threads

__all__ = ["LIBRARIES"]

LIBRARIES: list[Library] = [
    math.LIBRARY,
    poses.LIBRARY,
    strings.LIBRARY,
    lists.LIBRARY,
    threads.LIBRARY,
    checks.LIBRARY,
]
