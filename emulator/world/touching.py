"""From shapes to forces: the contacts between a tool and the things around it."""

from collections.abc import Iterable, Iterator
from math import sqrt
from typing import Final

from emulator.motion.axes import cross, dot
from emulator.motion.contact import Contact
from emulator.snapshot import Vector3, Vector6
from emulator.world.shapes import Box, Probe, WorldObject
from urproto.robots.pose import Pose

__all__ = ["NEAR_M", "contacts", "force_of", "velocity_at"]

NEAR_M: Final = 0.05  # contacts are known from this distance on: more than any tool moves in a period
_CREEP_M_S: Final = 1e-3  # friction grows with the sliding speed up to here, and is Coulomb's beyond (guess)


def contacts(tool: WorldObject, things: Iterable[WorldObject], tcp: Pose, speed: Vector6) -> Iterator[Contact]:
    """Where the tool touches, or soon will.

    ``tool``: its pose in the base frame; its stiffness and the rest do not count, those of the things do. ``tcp``:
    what levers are measured from. ``speed``: of the TCP, base frame [m/s, rad/s]. Two boxes touch with their corners;
    crossing edges go unnoticed.
    """
    for thing in things:
        for probe in tool.shape.probes:
            yield from _contact(thing, tool, probe, thing, 1.0, tcp, speed)
        if isinstance(tool.shape, Box):
            for probe in thing.shape.probes:
                yield from _contact(tool, thing, probe, thing, -1.0, tcp, speed)


def _contact(
    solid: WorldObject,
    owner: WorldObject,
    probe: Probe,
    material: WorldObject,
    sign: float,
    tcp: Pose,
    speed: Vector6,
) -> Iterator[Contact]:
    """A probe of ``owner`` against a solid; sign 1 when the probe is the tool's, -1 when the solid is."""
    centre = owner.place(probe.centre)
    touch = solid.touch(centre, probe.radius)
    if touch.depth < -NEAR_M:
        return
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
