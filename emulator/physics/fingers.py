"""Two fingers in a scene, and the motor that closes them until an object stops them."""

from collections.abc import Sequence
from typing import Any, Final

import mujoco

from emulator.physics.arm_bodies import PREFIX, quaternion
from emulator.physics.contacts import Kind, touching
from emulator.physics.plan import GripperShape

_SIDES: Final = (("left", 1.0), ("right", -1.0))
_FINGER_KG: Final = 0.1
_GEAR_KG: Final = 1.0  # inertia of motor and gear, at a finger (guess)
_PAD_FRICTION: Final = 0.7  # rubber; the friction of a part takes precedence, see touching() (guess)
_GAIN_N_M: Final = 20_000.0  # of the motor's position loop (guess)
_LOAD_SHARE: Final = 0.9  # fraction of its force at which a standing motor counts as stopped by an object
_STILL_M_S: Final = 0.002
_STOPPED_S: Final = 0.03  # duration for that (guess)
_LEAD_M: Final = 0.001  # of the setpoint, beyond the value that gives the full force
_RUBBER: Final = (0.15, 0.15, 0.16, 1.0)


def add_fingers(spec: Any, flange: Any, shape: GripperShape) -> None:
    """Add palm and fingers, coupled as by a gear, with a motor at each."""
    radius, length = shape.palm
    thickness, width, reach = shape.pad
    name = PREFIX + shape.name
    palm = flange.add_body(name=name, pos=list(shape.pose[:3]), quat=quaternion(shape.pose[3:]))
    palm.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        pos=[0.0, 0.0, 0.5 * length],
        size=[radius, 0.5 * length, 0.0],
        mass=0.0,
        rgba=_RUBBER,
        **touching(Kind.TOOL, _PAD_FRICTION),
    )
    for side, sign in _SIDES:
        finger = palm.add_body(name=f"{name}/{side}", pos=[0.0, 0.0, length])
        finger.gravcomp = 1.0  # its weight is part of the payload
        joint = f"{name}/{side}"
        half = 0.5 * shape.stroke
        finger.add_joint(
            name=joint,
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[0.0, sign, 0.0],
            limited=True,
            range=[0.0, half],
            ref=half,
            armature=_GEAR_KG,
        )
        finger.add_geom(
            name=f"{name}/{side}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[0.0, sign * (half + 0.5 * thickness), 0.5 * reach],
            size=[0.5 * width, 0.5 * thickness, 0.5 * reach],
            mass=_FINGER_KG,
            rgba=_RUBBER,
            **touching(Kind.TOOL, _PAD_FRICTION),
        )
        motor = spec.add_actuator(name=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint)
        motor.set_to_position(kp=_GAIN_N_M, dampratio=1.0)
        motor.forcelimited, motor.forcerange = True, [-shape.force[1], shape.force[1]]
    spec.add_equality(
        name=name,
        type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1=f"{name}/left",
        name2=f"{name}/right",
        data=[0.0, 1.0, *[0.0] * 10],
        solref=[0.004, 1.0],
    )


class Fingers:
    """The fingers of a compiled scene. ``width``: between the pads [m]. ``stopped``: an object blocks them."""

    def __init__(self, shape: GripperShape, model: Any) -> None:
        self.shape = shape
        first = f"{PREFIX}{shape.name}/{_SIDES[0][0]}"
        self._model = model
        # in all arrays, the second finger follows the first one
        self._motors = _both(model.actuator(first).id)
        self._qpos = _both(int(model.joint(first).qposadr[0]))
        self._dofs = _both(int(model.joint(first).dofadr[0]))
        self._setpoint = 0.5 * shape.stroke  # of each finger
        self._force = shape.force[1]
        self._stopped_s = 0.0
        self.width = shape.stroke

    @property
    def stopped(self) -> bool:
        return self._stopped_s >= _STOPPED_S

    def save(self) -> list[float]:
        """State of the motors, for `restore`."""
        return [self._setpoint, self._force, self._stopped_s, self.width]

    def restore(self, values: Sequence[float]) -> None:
        self._setpoint, self._force, self._stopped_s, self.width = values
        self._model.actuator_forcerange[self._motors] = (-self._force, self._force)

    def move(self, data: Any, goal: float | None, speed: float, force: float, period_s: float) -> None:
        """Command one period: move towards a width [m] at an opening speed [m/s]; None holds the fingers in place.

        force: maximum of each finger [N].
        """
        here = 0.5 * self.width
        wanted = here if goal is None else 0.5 * min(max(goal, 0.0), self.shape.stroke)
        lead = force / _GAIN_N_M + _LEAD_M
        if goal is not None:
            step = 0.5 * speed * period_s
            ahead = min(max(wanted - self._setpoint, -step), step)
            self._setpoint = min(max(self._setpoint + ahead, here - lead), here + lead)
        # to press, the setpoint has to be beyond the object
        pressing = goal is not None and self.stopped
        target = here + (lead if wanted > here else -lead) if pressing else self._setpoint
        if force != self._force:
            self._force = force
            self._model.actuator_forcerange[self._motors] = (-force, force)
        data.ctrl[self._motors] = target

    def update(self, data: Any, goal: float | None, period_s: float) -> None:
        """After the steps of a period: read the fingers' positions and whether an object stops them."""
        self.width = max(0.0, sum(data.qpos[self._qpos].tolist()))
        held = False
        if goal is not None and abs(self.width - goal) >= 2.0 * _LEAD_M:
            speed = max(map(abs, data.qvel[self._dofs].tolist()))
            load = max(map(abs, data.actuator_force[self._motors].tolist()))
            held = speed < _STILL_M_S and load > _LOAD_SHARE * self._force
        self._stopped_s = self._stopped_s + period_s if held else 0.0


def _both(first: int) -> slice:
    return slice(first, first + len(_SIDES))
