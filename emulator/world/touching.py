"""From shapes to forces: the contacts between a tool and the things around it."""

from collections.abc import Iterable, Iterator
from math import sqrt
from typing import Final

from emulator.motion.axes import cross, dot
from emulator.motion.contact import Contact
from emulator.snapshot import Vector3, Vector6
from emulator.world.shapes import Box, Probe, Touch, WorldObject
from urproto.robots.pose import Pose, pose_trans

__all__ = ["NEAR_M", "contacts", "force_of", "velocity_at"]

NEAR_M: Final = 0.05  # contacts are known from this distance on: more than any tool moves in a period
_AT_TCP: Final[Pose] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_CREEP_M_S: Final = 1e-3  # friction grows with the sliding speed up to here, and is Coulomb's beyond (guess)


def contacts(tool: WorldObject, things: Iterable[WorldObject], tcp: Pose, speed: Vector6) -> Iterator[Contact]:
    """Where the tool touches, or soon will.

    ``tool``: its pose in the frame of the TCP; its stiffness and the rest do not count, those of the things do.
    ``tcp``: base frame, and so is ``speed``, of the TCP [m/s, rad/s]. Two boxes touch with their corners; crossing
    edges go unnoticed.
    """
    box = tool.mounted(tcp) if isinstance(tool.shape, Box) else None
    balls = _balls(tool, tcp) if box is None else [(box.place(probe.centre), probe) for probe in box.shape.probes]
    for thing in things:
        for centre, probe in balls:
            yield from _contact(thing.touch(centre, probe.radius), centre, probe, (thing, 1.0), (tcp, speed))
        if box is not None:
            for probe in thing.shape.probes:
                centre = thing.place(probe.centre)
                yield from _contact(box.touch(centre, probe.radius), centre, probe, (thing, -1.0), (tcp, speed))


def _balls(tool: WorldObject, tcp: Pose) -> list[tuple[Vector3, Probe]]:
    """The parts of a round tool, in the base frame."""
    centre = (tcp[0], tcp[1], tcp[2]) if tool.pose == _AT_TCP else pose_trans(tcp, tool.pose)[:3]
    return [(centre, probe) for probe in tool.shape.probes]


def _contact(
    touch: Touch, centre: Vector3, probe: Probe, thing: tuple[WorldObject, float], tool: tuple[Pose, Vector6]
) -> Iterator[Contact]:
    """The contact of a probe in a solid. ``thing``: its material counts; 1 when the probe is the tool's, else -1."""
    if touch.depth < -NEAR_M:
        return
    material, sign = thing
    tcp, speed = tool
    x, y, z = touch.out
    deepest = (centre[0] - x * probe.radius, centre[1] - y * probe.radius, centre[2] - z * probe.radius)
    lever = (deepest[0] - tcp[0], deepest[1] - tcp[1], deepest[2] - tcp[2])
    normal = (sign * x, sign * y, sign * z)
    stiffness, damping = material.stiffness * probe.share, material.damping * probe.share
    force, grip = force_of(touch.depth, normal, (stiffness, damping, material.friction), velocity_at(lever, speed))
    yield Contact(lever, normal, touch.depth, stiffness, damping, grip, force)


def velocity_at(lever: Vector3, speed: Vector6) -> Vector3:
    """The velocity of a point of a body, from the body's speed at another."""
    turn = cross((speed[3], speed[4], speed[5]), lever)
    return (speed[0] + turn[0], speed[1] + turn[1], speed[2] + turn[2])


def force_of(
    depth: float, normal: Vector3, material: tuple[float, float, float], velocity: Vector3
) -> tuple[Vector3, float]:
    """Force on what moves with ``velocity`` [N], and its friction over its sliding speed [N s/m].

    ``material``: stiffness, damping, coefficient of friction. The contact pushes or does nothing.
    """
    if depth <= 0.0:
        return (0.0, 0.0, 0.0), 0.0
    stiffness, damping, coefficient = material
    away = dot(normal, velocity)
    push = stiffness * depth - damping * away
    if push <= 0.0:
        return (0.0, 0.0, 0.0), 0.0
    slide = tuple(v - away * n for v, n in zip(velocity, normal, strict=True))
    grip = coefficient * push / max(sqrt(dot(slide, slide)), _CREEP_M_S)
    x, y, z = (push * n - grip * v for n, v in zip(normal, slide, strict=True))
    return (x, y, z), grip
