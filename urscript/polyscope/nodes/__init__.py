"""The node types of program trees, a module for each kind. Importing this package registers them all."""

from urscript.polyscope.nodes import (
    direction,
    flow,
    force,
    moves,
    operator,
    outputs,
    scripts,
    structure,
    urcaps,
    waits,
    waypoints,
)

NODE_MODULES = (direction, flow, force, moves, operator, outputs, scripts, structure, urcaps, waits, waypoints)
