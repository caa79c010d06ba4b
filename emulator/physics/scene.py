"""Builds scenes: a plan as a MuJoCo model with the arm in it."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np

from emulator.physics.arm_bodies import FLANGE, MOUNTING, PREFIX, TOOL, DrivenArm, add_arm, quaternion
from emulator.physics.contacts import Kind, classify, touching
from emulator.physics.description import Camera, Joint, Moving
from emulator.physics.fingers import add_fingers
from emulator.physics.holders import add_changer, add_suction
from emulator.physics.plan import MountedShape, PhysicsPlan
from urproto.robots import RobotModel, kinematics_of
from urproto.worldfile import ObjectDescription

_OVERLAP_M: Final = 0.002  # permitted overlap of objects at the start: they push each other apart gently (guess)
_MAX_STEPS: Final = 100  # in a control period of 8 ms
_ARMATURE_KG: Final = 0.05  # of a cylinder's drive (guess)
_DRIVE_GAIN: Final = 20.0  # of a cylinder's drive: full force from a twentieth of its stroke (guess)
_FRICTION: Final = 0.6  # of a moving object without its own (guess)
_PLANE: Final = [0.0, 0.0, 0.05]
_TYPES: Final = {
    "plane": mujoco.mjtGeom.mjGEOM_PLANE,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}
_STAYING: Final = (0.55, 0.6, 0.65, 1.0)
_MOVING: Final = (0.85, 0.45, 0.2, 1.0)


# Without this, MuJoCo writes a file MUJOCO_LOG.TXT to the folder in which the emulator was started.
if mujoco.get_mju_user_warning() is None:
    mujoco.set_mju_user_warning(logging.getLogger(__name__).debug)


class SceneError(ValueError):
    """A scene cannot be built."""


@dataclass(frozen=True)
class Scene:
    """A compiled model. steps: per control period."""

    model: Any
    steps: int
    drives: Mapping[str, int] = field(default_factory=dict)  # actuators of joints with an output, by the object's name


def build(plan: PhysicsPlan, arm: RobotModel, period_s: float) -> Scene:
    """Build the plan's scene with an arm in it. Raises SceneError."""
    try:
        spec = _empty(plan.step_s) if plan.scene is None else _read(plan.scene)
        _prepare(spec)
        for name, thing in plan.objects.items():
            _add_object(spec, name, thing, plan.moving[name])
        add_arm(spec, arm, tool=plan.tool is not None)
        _add_mounted(spec, plan)
        for name, camera in plan.cameras.items():
            _add_camera(spec, name, camera)
        if not spec.lights:
            spec.worldbody.add_light(pos=[0.5, -0.5, 2.5], dir=[-0.2, 0.2, -1.0], castshadow=False)
        wanted = min(plan.step_s, spec.option.timestep)
        steps = max(1, int(np.ceil(period_s / wanted - 1e-9)))
        if steps > _MAX_STEPS:
            raise SceneError(f"the time step of {spec.option.timestep:g} s is too short: use 0.0001 or more")
        spec.option.timestep = period_s / steps
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise SceneError(" ".join(str(error).split())) from error
    drives = {name: model.actuator(PREFIX + name).id for name, moving in plan.moving.items() if _driven(moving)}
    return Scene(model, steps, drives)


def check_start(scene: Scene, arm: RobotModel, q: Sequence[float]) -> None:
    """Raise SceneError if objects, or an object and the arm at q [rad], overlap at the start."""
    model, data = scene.model, mujoco.MjData(scene.model)
    flange = kinematics_of(arm).forward(q)
    DrivenArm(arm, model, data).place(q, flange, flange)
    mujoco.mj_forward(model, data)
    if not np.isfinite(data.qacc).all():
        raise SceneError("masses or positions of objects are not finite numbers")
    for i in range(data.ncon):
        depth = -float(data.contact.dist[i])
        if depth <= _OVERLAP_M:
            continue
        one, other = sorted(_owner(model, geom) for geom in data.contact.geom[i])
        problem = f"{one} and {other} overlap by {1000.0 * depth:.1f} mm at the start"
        own = PREFIX in one + other
        raise SceneError(f"{problem}: " + ("start elsewhere (--initial-positions)" if own else "move one of them"))


def _owner(model: Any, geom: int) -> str:
    body = int(model.geom_bodyid[geom])
    return model.geom(geom).name or model.body(body).name.removesuffix(MOUNTING) if body else "a fixed object"


def _empty(step_s: float) -> Any:
    spec = mujoco.MjSpec()
    spec.option.timestep = step_s
    return spec


def _read(path: Path) -> Any:
    try:
        return mujoco.MjSpec.from_file(str(path))
    except (ValueError, mujoco.FatalError, OSError) as error:
        raise SceneError(" ".join(str(error).split()) or "the file cannot be read") from error


def _prepare(spec: Any) -> None:
    """Set the options of all scenes, and contact parameters that a scene file leaves open."""
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC  # friction is the same in all directions
    spec.option.impratio = 10.0  # held objects do not creep out of the fingers
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if spec.option.jacobian == mujoco.mjtJacobian.mjJAC_AUTO:  # its automatic choice would depend on the mounted parts
        spec.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # instabilities are reported instead
    for body in spec.bodies:
        if body.name.startswith(PREFIX):
            raise SceneError(f"the name {body.name} is reserved for the arm: choose another one")
        body.name = body.name or f"body {body.id}"
        staying = _stays(body)
        for geom in body.geoms:
            classify(geom, staying=staying)


def _stays(body: Any) -> bool:
    """Whether a body is fixed: no joint moves it."""
    while body is not None and body.name != "world":
        if body.joints or body.mocap:
            return False
        body = body.parent
    return True


def _add_object(spec: Any, name: str, thing: ObjectDescription, moving: Moving) -> None:
    body = spec.worldbody.add_body(name=name, pos=list(thing.pose[:3]), quat=quaternion(thing.pose[3:]))
    kind, usual = (Kind.STAYING, 0.0) if moving.mass is None else (Kind.FREE, _FRICTION)
    material = touching(kind, thing.material.get("friction", usual))
    if moving.conveyor is not None:
        material["surfacevel"] = [moving.conveyor.speed, 0.0, 0.0, 0.0, 0.0, 0.0]  # a 0 could not be changed later
    _add_shape(spec, body, name, thing, moving, **material)
    if moving.joint is not None:
        _add_joint(spec, body, name, moving.joint, turns=moving.hinge is not None)
    elif moving.mass is not None:
        body.add_freejoint(name=name)


def _add_shape(spec: Any, body: Any, name: str, thing: ObjectDescription, moving: Moving, **material: Any) -> Any:
    colour = (*moving.colour, 1.0) if moving.colour else _STAYING if moving.mass is None else _MOVING
    values: dict[str, Any] = {"name": name, "type": _TYPES[thing.shape], "rgba": colour, **material}
    if thing.shape == "mesh":
        spec.add_mesh(name=name, file=thing.mesh)
        values["meshname"] = name
    else:
        values["size"] = _half(thing)
    if moving.mass is not None:
        values["mass"] = moving.mass
    return body.add_geom(**values)


def _half(thing: ObjectDescription) -> Sequence[float]:
    """The sizes in MuJoCo's form: half lengths."""
    match thing.shape:
        case "plane":
            return _PLANE
        case "box":
            return [0.5 * edge for edge in thing.sizes]
        case "sphere":
            return [thing.sizes[0], 0.0, 0.0]
        case _:
            return [thing.sizes[0], 0.5 * thing.sizes[1], 0.0]


def _add_joint(spec: Any, body: Any, name: str, joint: Joint, *, turns: bool) -> None:
    kind = mujoco.mjtJoint.mjJNT_HINGE if turns else mujoco.mjtJoint.mjJNT_SLIDE
    degrees = turns and spec.compiler.degree
    # In 4.0 the polynomial spring's and damper's first coefficients are those of the linear ones.
    body.add_joint(
        name=name,
        type=kind,
        axis=list(joint.axis),
        pos=list(joint.at),
        limited=True,
        range=[float(np.degrees(end)) if degrees else end for end in joint.range],
        stiffness=[joint.stiffness, 0.0, 0.0],
        damping=[joint.damping, 0.0, 0.0],
        armature=_ARMATURE_KG if joint.output is not None else 0.0,
    )
    if joint.output is None:
        return
    gain = _DRIVE_GAIN * joint.force / abs(joint.far)
    actuator = spec.add_actuator(name=PREFIX + name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)
    actuator.set_to_position(kp=gain, dampratio=1.0)
    actuator.forcelimited, actuator.forcerange = True, [-joint.force, joint.force]


def _driven(moving: Moving) -> bool:
    return moving.joint is not None and moving.joint.output is not None


def _add_mounted(spec: Any, plan: PhysicsPlan) -> None:
    flange = spec.body(PREFIX + FLANGE + MOUNTING)
    movable = [body.name for body in spec.bodies if body.joints and not body.name.startswith(PREFIX)]
    if plan.tool is not None:
        _add_mounted_shape(spec, spec.body(PREFIX + TOOL + MOUNTING), "tool", plan.tool, MountedShape(0.0))
    if plan.gripper is not None:
        add_fingers(spec, flange, plan.gripper)
    for name, (thing, shape) in plan.mounted_shapes.items():
        _add_mounted_shape(spec, flange, name, thing, shape)
    for name, cup in plan.cups.items():
        add_suction(
            spec, spec.body(cup.tool) if cup.tool else flange, name, cup, [one for one in movable if one != cup.tool]
        )
    for gripper in plan.output_grippers.values():
        add_fingers(spec, spec.body(gripper.tool) if gripper.tool else flange, gripper)
    for name, plate in plan.changers.items():
        add_changer(spec, flange, name, plate, plan.couplings)


def _add_mounted_shape(spec: Any, parent: Any, name: str, thing: ObjectDescription, shape: MountedShape) -> None:
    body = parent.add_body(name=f"{PREFIX}{name}/mounted", pos=list(thing.pose[:3]), quat=quaternion(thing.pose[3:]))
    geom = _add_shape(
        spec, body, PREFIX + name, thing, Moving(mass=1.0, colour=shape.colour), **touching(Kind.TOOL, shape.friction)
    )
    geom.mass = 0.0  # it is part of the payload


def _add_camera(spec: Any, name: str, camera: Camera) -> None:
    parent = spec.worldbody if camera.frame == "base" else spec.body(PREFIX + FLANGE)
    # MuJoCo's cameras look along -z with y up: half a turn about x from the optical frame.
    pose = camera.placed
    w, x, y, z = quaternion(pose[3:])
    fovy = camera.fov if not spec.compiler.degree else float(np.degrees(camera.fov))
    parent.add_camera(name=name, pos=list(pose[:3]), quat=[-x, w, z, -y], fovy=fovy)
