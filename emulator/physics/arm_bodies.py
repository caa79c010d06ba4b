"""The arm in a scene: bodies that follow the controller's arm exactly, whatever is in their way.

Each link is a free body whose mass is large compared with everything else, without gravity. Once a control period, it
is placed where the link was, with the velocity that takes it to where the link is now, and keeps that velocity through
the steps of the period. An object that touches it therefore feels a moving surface: friction carries what fingers hold.

Parts that touch the tool do so through a stiff spring at the flange (``COMPLIANCE_N_M``), like the compliance of an
arm's joints and gears. The solver then only deals with bodies of ordinary mass, and force control knows by how much a
contact force can grow in a period. docs/physics.md describes what else was tried.

Shapes are the capsules of `urproto.robots.shapes`; links touch objects, never each other.
"""

from collections.abc import Sequence
from math import sqrt
from struct import Struct
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

from emulator.physics.contacts import Kind, touching
from urproto.robots import RobotModel
from urproto.robots.pose import rotvec_to_quaternion
from urproto.robots.shapes import Capsule, capsules
from urproto.vectors import ZERO3

if TYPE_CHECKING:
    from emulator.robot.arm import Arm

MASS_KG: Final = 1e4
"""Of each driven body, and its inertia in kg m2: 100 N change its speed by less than 0.1 mm/s in a step."""
LINKS: Final = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2")
FLANGE: Final = "flange"
TOOL: Final = "tool"
"""Name of the tool in world files: the body at the TCP."""
_BODIES: Final = (*LINKS, FLANGE, TOOL)  # the last one only where something is fixed to it
PREFIX: Final = "ur/"
_DARK: Final = (0.2, 0.2, 0.25, 1.0)
COMPLIANCE_N_M: Final = 1e5  # of the flange's spring; arms of this size have stiffnesses like that (guess)
_COMPLIANCE_NM_RAD: Final = 2000.0  # guess
_SPRUNG_KG: Final = 2.0  # mass and inertia between spring and tool: required by the solver, not real
_SPRUNG_KG_M2: Final = 0.02
_DAMPING_N_S_M: Final = 2.0 * sqrt(COMPLIANCE_N_M * _SPRUNG_KG)  # critical
_DAMPING_NM_S: Final = 2.0 * sqrt(_COMPLIANCE_NM_RAD * _SPRUNG_KG_M2)
MOUNTING: Final = "/mounting"
_LINK_FRICTION: Final = 0.3  # painted aluminium (guess)
_JUMP_M: Final = 0.5  # an arm that moves farther in a period was placed elsewhere
_PLACE: Final = Struct("7d")
_GREY: Final = (0.75, 0.76, 0.78, 1.0)


def quaternion(rotvec: Sequence[float]) -> list[float]:
    """Quaternion in MuJoCo's order, real part first."""
    x, y, z, w = rotvec_to_quaternion(rotvec[0], rotvec[1], rotvec[2])
    return [w, x, y, z]


def add_arm(spec: Any, model: RobotModel, *, tool: bool) -> None:
    """Add the driven bodies to a scene, after everything else. ``tool``: also add the body at the TCP."""
    foot, *links = capsules(model)
    _add_capsule(spec.worldbody, foot, Kind.BASE)
    for name, capsule, along in zip(_BODIES, [*links, None], [*model.dh.d[:5], 0.0, 0.0], strict=True):
        if name == TOOL and not tool:
            continue
        body = spec.worldbody.add_body(name=PREFIX + name)
        body.add_freejoint(name=PREFIX + name)
        _weightless(body, MASS_KG, MASS_KG)
        if name in (FLANGE, TOOL):
            body = _sprung(body, name)
        if capsule is not None:
            kind = Kind.TOOL if name == FLANGE else Kind.BASE if name == "shoulder" else Kind.LINK
            _add_capsule(body, _moved(capsule, along), kind)


def add_fitting(
    flange: Any, name: str, pose: Sequence[float], radius_m: float, length_m: float, friction: float
) -> Any:
    """Fix a massless cylinder to the flange, with its far end at a pose, along that z axis; returns its body."""
    x, y, z, *turn = (*pose, 0.0, 0.0, 0.0)[:6]
    body = flange.add_body(name=PREFIX + name, pos=[x, y, z], quat=quaternion(turn))
    body.add_geom(
        name=PREFIX + name,
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        pos=[0.0, 0.0, -0.5 * length_m],
        size=[radius_m, 0.5 * length_m, 0.0],
        mass=0.0,
        rgba=_DARK,
        **touching(Kind.TOOL, friction),
    )
    return body


def _weightless(body: Any, mass_kg: float, inertia_kg_m2: float) -> None:
    body.gravcomp = 1.0
    body.explicitinertial, body.mass, body.inertia = True, mass_kg, [inertia_kg_m2] * 3


def _sprung(parent: Any, name: str) -> Any:
    """Add a body that is held by a spring in all directions."""
    body = parent.add_body(name=PREFIX + name + MOUNTING)
    _weightless(body, _SPRUNG_KG, _SPRUNG_KG_M2)
    for axis in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]):
        body.add_joint(
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=axis,
            stiffness=[COMPLIANCE_N_M, 0.0, 0.0],
            damping=[_DAMPING_N_S_M, 0.0, 0.0],
        )
    body.add_joint(
        type=mujoco.mjtJoint.mjJNT_BALL,
        stiffness=[_COMPLIANCE_NM_RAD, 0.0, 0.0],
        damping=[_DAMPING_NM_S, 0.0, 0.0],
    )
    return body


def _moved(capsule: Capsule, along: float) -> Capsule:
    """From the frame at a joint's end along its axis to the one at its beginning."""
    (ax, ay, az), (bx, by, bz) = capsule.start, capsule.end
    return Capsule((ax, ay, az + along), (bx, by, bz + along), capsule.radius)


def _add_capsule(body: Any, capsule: Capsule, kind: Kind) -> None:
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[*capsule.start, *capsule.end],
        size=[capsule.radius, 0.0, 0.0],
        rgba=_GREY,
        mass=0.0,
        **touching(kind, _LINK_FRICTION, MASS_KG),
    )


class Skeleton:
    """Forward kinematics of the links: of the nominal arm, as in `ArmCapsules`."""

    def __init__(self, model: RobotModel) -> None:
        spec = mujoco.MjSpec()
        parent, offset, tilt = spec.worldbody, list(ZERO3), [1.0, 0.0, 0.0, 0.0]
        for a, d, alpha, theta in zip(model.dh.a, model.dh.d, model.dh.alpha, model.dh.theta, strict=True):
            parent = parent.add_body(pos=offset, quat=tilt)
            parent.explicitinertial, parent.mass, parent.inertia = True, 1.0, [1.0] * 3
            parent.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 0.0, 1.0], ref=-theta)
            offset, tilt = [a, 0.0, d], quaternion((alpha, 0.0, 0.0))
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        own = slice(1, len(LINKS) + 1)
        self._frames = self._data.xpos[own], self._data.xquat[own]

    def frames(self, q: Sequence[float]) -> tuple[Any, Any]:
        """Positions and quaternions of the links' frames, shoulder to wrist 2, each turned with its joint."""
        self._data.qpos[:] = q
        mujoco.mj_kinematics(self._model, self._data)
        return self._frames


class _Places:
    """Positions and quaternions of the driven bodies, one row each: as a flat vector, and in parts."""

    def __init__(self, count: int) -> None:
        self._bytes = bytearray(count * _PLACE.size)
        self.flat = np.frombuffer(self._bytes)
        rows = self.flat.reshape(-1, 7)
        self.links = rows[: len(LINKS), :3], rows[: len(LINKS), 3:]

    def put(self, number: int, pose: Sequence[float]) -> None:
        """Set a body after the links. By bytes, since assigning a row of an array takes twice as long."""
        x, y, z, *turn = pose
        _PLACE.pack_into(self._bytes, (len(LINKS) + number) * _PLACE.size, x, y, z, *quaternion(turn))


class DrivenArm:
    """The driven bodies of a compiled scene in one state. ``bodies``: their numbers, by name without the prefix."""

    def __init__(self, model: RobotModel, scene: Any, data: Any) -> None:
        self._skeleton = Skeleton(model)
        ids = {name: mujoco.mj_name2id(scene, mujoco.mjtObj.mjOBJ_BODY, PREFIX + name) for name in _BODIES}
        self.bodies = {name: number for name, number in ids.items() if number >= 0}
        self._free = _free_bodies(len(self.bodies))
        joints = [scene.joint(PREFIX + name) for name in self.bodies]
        self._qpos = _runs(data.qpos, [int(joint.qposadr[0]) for joint in joints], 7)
        self._qvel = _runs(data.qvel, [int(joint.dofadr[0]) for joint in joints], 6)
        self._before, self._now = _Places(len(self.bodies)), _Places(len(self.bodies))
        self._speed = np.zeros(6 * len(self.bodies))
        self._way = self._speed.reshape(-1, 6)[:, :3]
        self._placed = False
        self._where: tuple[Sequence[float], ...] = ()  # in the last period
        self._stands = False  # since then

    def place(self, q: Sequence[float], flange: Sequence[float], tcp: Sequence[float]) -> None:
        """Place the bodies where an arm is, at rest. Poses in the base frame."""
        self._where, self._stands = (q, flange, tcp), False
        self._locate(*self._where)
        self._speed[:] = 0.0
        self._placed = True
        _put(self._now.flat, self._qpos)
        _put(self._speed, self._qvel)

    def begin(self, arm: "Arm", period_s: float) -> None:
        """Begin a period in which the arm moved to its present position."""
        where = arm.q, arm.flange_pose, arm.tcp_pose
        if where == self._where and self._placed:
            if not self._stands:
                self._before.flat[:] = self._now.flat
                self._speed[:] = 0.0
                self._stands = True
            _put(self._now.flat, self._qpos)
            return
        self._where, self._stands = where, False
        self._before, self._now = self._now, self._before
        self._locate(*where)
        mujoco.mj_differentiatePos(self._free, self._speed, 1.0, self._before.flat, self._now.flat)
        if not self._placed or (self._speed @ self._speed > _JUMP_M**2 and abs(self._way).max() > _JUMP_M):
            self.place(*where)
            return
        self._speed /= period_s
        _put(self._before.flat, self._qpos)

    def drive(self) -> None:
        """Before each step: restore the bodies' velocities, which the last step may have changed."""
        _put(self._speed, self._qvel)

    def end(self) -> None:
        """After the last step of a period: place the bodies exactly where the arm is."""
        _put(self._now.flat, self._qpos)

    def _locate(self, q: Sequence[float], flange: Sequence[float], tcp: Sequence[float]) -> None:
        positions, turns = self._now.links
        positions[:], turns[:] = self._skeleton.frames(q)
        self._now.put(0, flange)
        if len(self.bodies) == len(_BODIES):
            self._now.put(1, tcp)


def _free_bodies(count: int) -> Any:
    """A model of free bodies only, so that MuJoCo calculates the motion between two placements in one call."""
    spec = mujoco.MjSpec()
    for _ in range(count):
        body = spec.worldbody.add_body()
        body.explicitinertial, body.mass, body.inertia = True, 1.0, [1.0] * 3
        body.add_freejoint()
    return spec.compile()


def _runs(values: Any, addresses: Sequence[int], width: int) -> list[tuple[Any, slice]]:
    """Views of a MuJoCo vector, ``width`` numbers at each address, with the slice of the source for each.

    Neighbouring parts are merged.
    """
    runs: list[tuple[int, int, int]] = []
    for i, address in enumerate(addresses):
        if runs and runs[-1][1] == address:
            runs[-1] = runs[-1][0], address + width, runs[-1][2]
        else:
            runs.append((address, address + width, i * width))
    return [(values[start:end], slice(first, first + end - start)) for start, end, first in runs]


def _put(numbers: Any, runs: Sequence[tuple[Any, slice]]) -> None:
    for part, whose in runs:
        part[:] = numbers[whose]
