"""The world with physics of one controller: it advances in each control period by the steps that fit into it.

The scene follows the arm with a delay of one control period: it steps to the position the arm published last, which a
world of springs uses too. The force on the tool is the mean over the steps, so that no impulse is lost.
"""

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

from emulator.motion import Motion
from emulator.motion.contact import Contact
from emulator.physics.arm_bodies import COMPLIANCE_N_M, FLANGE, LINKS, PREFIX, DrivenArm, quaternion
from emulator.physics.description import Camera
from emulator.physics.disturbances import SceneDisturbances
from emulator.physics.scene import Scene
from emulator.physics.wiring import Wires
from emulator.robot.installation import Payload
from emulator.world.shapes import WorldObject
from emulator.world.world import POINT, Wiring, World, WorldError
from urproto.robots import RobotModel
from urproto.robots.pose import quaternion_to_rotvec, rotvec_to_matrix
from urproto.vectors import ZERO6, Vector3, Vector6, add, as_six, cross, lerp, rotate, sub3

if TYPE_CHECKING:
    from emulator.physics.plan import PhysicsPlan
    from emulator.robot.arm import Arm

_EXPLODED: Final = slice(mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQACC + 1)
assert mujoco.mjtWarning.mjWARN_BADQVEL in range(_EXPLODED.start, _EXPLODED.stop)
_FASTEST_M_S: Final = 1e3  # no real object in a cell moves that fast
_STATE: Final = mujoco.mjtState.mjSTATE_INTEGRATION
_MIN_N: Final = 1e-6
_DAMPING_N_S_M: Final = 200.0  # of contacts, as used by force control (guess)
_PLAIN: Final = Camera(pose=(0.0,) * 6)  # default size of the cameras of a scene file
_FIXED: Final = "the objects of a world with physics are those of its file: "


class PhysicsWorld(World):
    """The scene of one arm. ``failure``: reason why it has stopped, "" while it runs.

    cameras: by name, including those of a scene file. covered: names of cameras with a covered lens.
    """

    def __init__(self, plan: "PhysicsPlan", robot: RobotModel, scene: Scene) -> None:
        super().__init__(POINT)
        self.plan, self.scene = plan, scene
        self.model, self.data = scene.model, mujoco.MjData(scene.model)
        self.failure = ""
        names = [scene.model.camera(i).name for i in range(scene.model.ncam)]
        self.cameras: Mapping[str, Camera] = {name: plan.cameras.get(name, _PLAIN) for name in names if name}
        self.covered: set[str] = set()
        self._arm = DrivenArm(robot, scene.model, self.data)
        # The arm's bodies come last: its links, then flange and tool with the mounted parts.
        self._link, self._tool = self._arm.bodies[LINKS[0]], self._arm.bodies[FLANGE]
        self._is_tool = np.arange(scene.model.nbody) >= self._tool
        bodies = [(scene.model.body(i).name, i) for i in range(1, scene.model.nbody)]
        self._names = {name: i for name, i in bodies if not name.startswith(PREFIX)}
        self._step_forces = self.data.cfrc_ext  # of the last step: torque and force on each body, about its tree
        self._forces = np.zeros_like(self._step_forces)
        self._all_forces, self._speeds = self._forces.reshape(-1), self.data.qvel
        self._warnings = self.data.warning.number[_EXPLODED]
        self._gravity: Vector3 | None = None  # in the last period
        self._on_links, self._on_tool = self._forces[self._link : self._tool], self._forces[self._tool :]
        self._roots = [i for i in self._names.values() if scene.model.body_parentid[i] == 0]  # which `move` may move
        self._wires: Wires | None = None
        self._started = self._restored = False
        mujoco.mj_forward(self.model, self.data)
        self._first = self._good = np.zeros(0)
        self.payload = _payload(plan)

    # interface of World

    def wire(self, wiring: Wiring) -> None:
        self._wires = Wires(self.plan, self.scene, wiring.signals, wiring.encoders, wiring.gripper)
        self._first = self._good = self._saved()
        self.disturbances = SceneDisturbances(
            self.model, self.data, self._names, self._wires, self.cameras.keys(), self.covered
        )

    def act(self, arm: "Arm", motion: Motion, wrench: Vector6, period_s: float) -> Vector6:
        wrench = lerp(wrench, self._pushed(arm, period_s), 1.0)
        if self.failure or not arm.known:
            return wrench
        if self._restored:
            self._restored = False
            self._clear_contacts(arm, motion)
            return wrench
        if not self._started:
            self._arm.place(arm.q, arm.flange_pose, arm.tcp_pose)
            self._started = True
            if self.payload is not None and arm.mounted is None:
                arm.mounted = self.payload
        self._step(arm, period_s)
        if self.failure:
            self._clear_contacts(arm, motion)
            return wrench
        force_control = motion.force_control
        self.contacts = force_control.contacts = tuple(self._touching(arm)) if force_control.active else ()
        arm.link_torque = self._link_torque(arm)
        return add(wrench, self._wrench_at(self._tool, self._on_tool, arm.tcp_pose))

    def names(self) -> list[str]:
        return list(self._names)

    def poses(self) -> dict[str, Vector6]:
        return {name: self.pose(name) for name in self._names}

    def add(self, name: str, thing: WorldObject) -> None:
        raise WorldError(f"{_FIXED}{name!r} cannot be added")

    def remove(self, name: str) -> None:
        raise WorldError(f"{_FIXED}{name!r} cannot be removed: move it away")

    def mount(self, tool: WorldObject) -> None:
        if tool is not POINT:
            raise WorldError(f"{_FIXED}the tool cannot be changed")

    def move(self, name: str, pose_base: Vector6) -> None:
        if not all(map(np.isfinite, pose_base)):
            raise WorldError(f"a pose must be six finite numbers, not {list(pose_base)}")
        body = self._body(name)
        joint = int(self.model.body_jntadr[body])
        if joint >= 0 and self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            address, dof = int(self.model.jnt_qposadr[joint]), int(self.model.jnt_dofadr[joint])
            self.data.qpos[address : address + 7] = [*pose_base[:3], *quaternion(pose_base[3:])]
            self.data.qvel[dof : dof + 6] = 0.0
        elif self.model.body_parentid[body] == 0:
            self.model.body_pos[body], self.model.body_quat[body] = pose_base[:3], quaternion(pose_base[3:])
        else:
            raise WorldError(f"{name!r} is part of another body and cannot be moved by itself")
        mujoco.mj_kinematics(self.model, self.data)  # so that `pose` returns it immediately

    def save(self) -> list[float]:
        values: list[float] = self._saved().tolist()
        return values

    def restore(self, state: Sequence[float] | None) -> None:
        """Restore a state, also after a failure; the arm follows the controller's.

        The controller's arm may also be placed elsewhere in the next period. The scene waits until then, so that the
        moving arm does not sweep objects away.
        """
        first = self._first
        values = first if state is None else np.array(state, dtype=float)
        if values.shape != first.shape or not np.isfinite(values).all():
            raise WorldError(f"the state of this scene must be {len(first)} finite numbers")
        self._apply_state(values)
        self._good = values
        self.failure, self._started, self._restored = "", False, True

    # in addition to the interface of World

    def pose(self, name: str) -> Vector6:
        """Pose of a body in the base frame. Raises WorldError for an unknown one."""
        body = self._body(name)
        w, x, y, z = self.data.xquat[body].tolist()
        return as_six((*self.data.xpos[body].tolist(), *quaternion_to_rotvec(x, y, z, w)))

    def velocity(self, name: str) -> Vector6:
        """Velocity of a body: of its centre of mass [m/s], and its rotation [rad/s], in the base frame's axes."""
        found = np.zeros(6)
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_BODY, self._body(name), found, 0)
        return as_six((*found[3:].tolist(), *found[:3].tolist()))

    @property
    def wires(self) -> Wires:
        assert self._wires is not None, "the controller wires its world"
        return self._wires

    # one period

    def _step(self, arm: "Arm", period_s: float) -> None:
        model, data, wires = self.model, self.data, self.wires
        if arm.effective_gravity is not self._gravity:
            x, y, z = self._gravity = arm.effective_gravity
            model.opt.gravity[:] = (-x, -y, -z)
        wires.act(data, period_s)
        driven, forces, step_forces = self._arm, self._forces, self._step_forces
        driven.begin(arm, period_s)
        forces.fill(0.0)
        for _ in range(self.scene.steps):
            driven.drive()
            mujoco.mj_step(model, data)
            mujoco.mj_rnePostConstraint(model, data)
            forces += step_forces
            wires.step(data)
        driven.end()
        forces /= self.scene.steps
        if problem := self._problem():
            self._stop(problem)
            return
        wires.update(data, period_s)

    def _problem(self) -> str:
        data, forces, speeds = self.data, self._all_forces, self._speeds
        if np.count_nonzero(self._warnings) or not isfinite(forces.dot(forces)):  # twice as fast as @
            return "forces and speeds grew without bound"
        if speeds.dot(speeds) < _FASTEST_M_S**2:
            return ""
        fastest = int(np.argmax(np.abs(data.qvel)))
        if abs(data.qvel[fastest]) > _FASTEST_M_S:
            body = self.model.body(int(self.model.dof_bodyid[fastest])).name
            return f"{body} moves at {abs(data.qvel[fastest]):.3g} m/s"
        return ""

    def _stop(self, problem: str) -> None:
        """Return the scene to its last good state and stop it."""
        self._apply_state(self._good)
        self.failure = f"the physics of {self.plan.source.name} became unstable ({problem}): stopped until reset_world"

    def _saved(self) -> Any:
        """MuJoCo's state, the poses of objects that only `move` can move, and the state of grippers."""
        values = np.zeros(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, values, _STATE)
        places = self.model.body_pos[self._roots], self.model.body_quat[self._roots]
        return np.concatenate([values, *(place.ravel() for place in places), self.wires.save()])

    def _apply_state(self, values: Any) -> None:
        """Apply a state from `_saved`. Raises ValueError."""
        count = len(self._roots)
        own, positions, turns, rest = np.split(
            values, np.cumsum([mujoco.mj_stateSize(self.model, _STATE), 3 * count, 4 * count])
        )
        self.wires.restore(rest.tolist())
        self.model.body_pos[self._roots] = positions.reshape(count, 3)
        self.model.body_quat[self._roots] = turns.reshape(count, 4)
        mujoco.mj_setState(self.model, self.data, own, _STATE)
        mujoco.mj_forward(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, own, _STATE)  # again: the solver's warm start is part of it
        self.data.warning.number[:] = 0

    # effects on the arm

    def _clear_contacts(self, arm: "Arm", motion: Motion) -> None:
        self.contacts = motion.force_control.contacts = ()
        arm.link_torque = ZERO6

    def _wrench_at(self, first: int, forces: Any, tcp: Sequence[float]) -> Vector6:
        """Sum of the forces on bodies, from the first on, about a point, base frame [N, Nm].

        MuJoCo gives them about the centre of mass of a body's tree.
        """
        total = ZERO6
        if not np.count_nonzero(forces):
            return total
        for body, force in enumerate(forces.tolist(), first):
            tx, ty, tz, fx, fy, fz = force
            if fx or fy or fz or tx or ty or tz:
                centre = self.data.subtree_com[self.model.body_rootid[body]].tolist()
                mx, my, mz = cross(sub3(centre, tcp), (fx, fy, fz))
                total = add(total, (fx, fy, fz, tx + mx, ty + my, tz + mz))
        return total

    def _link_torque(self, arm: "Arm") -> Vector6:
        total = ZERO6
        if not np.count_nonzero(self._on_links):
            return total
        for i in np.flatnonzero(self._on_links.any(axis=1)).tolist():
            body, carrying = self._link + i, i + 1
            point = tuple(self.data.subtree_com[body].tolist())
            wrench = self._wrench_at(body, self._on_links[i : i + 1], point)
            rows = arm.kinematics.jacobian_at(arm.q, (*point, 0.0, 0.0, 0.0))
            torques = [sum(row[n] * part for row, part in zip(rows, wrench, strict=True)) for n in range(carrying)]
            total = add(total, (*torques, *ZERO6)[:6])
        return total

    def _touching(self, arm: "Arm") -> list[Contact]:
        """Contacts of the tool and of objects it carries, for force control.

        None is stiffer than the flange's spring. An object between the fingers moves along and does not count itself.
        """
        data, found = self.data, []
        pairs = data.contact.geom[: data.ncon]
        if not len(pairs):
            return []
        bodies = self.model.geom_bodyid[pairs]
        own = self._is_tool[bodies]
        if not own.any():
            return []
        carried = self._is_tool.copy()
        carried[self.model.body_weldid[bodies[own.any(axis=1)]]] = True
        carried[0] = False
        mine = carried[self.model.body_weldid[bodies]] | own
        force = np.zeros(6)
        for i in np.flatnonzero(mine[:, 0] != mine[:, 1]).tolist():
            mujoco.mj_contactForce(self.model, data, i, force)
            if force[0] < _MIN_N:
                continue
            sign = -1.0 if mine[i, 0] else 1.0  # the frame's x axis points from the first geom to the second
            axes = data.contact.frame[i].reshape(3, 3)
            nx, ny, nz = (sign * axes[0]).tolist()
            fx, fy, fz = (sign * (force[:3] @ axes)).tolist()
            lever = sub3(data.contact.pos[i].tolist(), arm.tcp_pose)
            depth = float(force[0]) / COMPLIANCE_N_M
            found.append(Contact(lever, (nx, ny, nz), depth, COMPLIANCE_N_M, _DAMPING_N_S_M, 0.0, (fx, fy, fz)))
        return found

    def _body(self, name: str) -> int:
        if name not in self._names:
            there = ", ".join(self._names) or "none"
            raise WorldError(f"there is no object {name!r}; there are: {there}")
        return self._names[name]


def _payload(plan: "PhysicsPlan") -> Payload | None:
    """Everything mounted on the flange, as one mass; None if it has no mass."""
    parts: list[tuple[float, Vector3]] = []
    for thing, shape in plan.mounted_shapes.values():
        parts.append((shape.mass, thing.pose[:3]))
    on_flange = [gripper for gripper in plan.output_grippers.values() if not gripper.tool]
    for gripper in (*on_flange, *((plan.gripper,) if plan.gripper else ())):
        matrix = rotvec_to_matrix(*gripper.pose[3:6])
        x, y, z = rotate(matrix, (0.0, 0.0, 0.5 * gripper.palm[1]))
        parts.append((gripper.mass, (gripper.pose[0] + x, gripper.pose[1] + y, gripper.pose[2] + z)))
    mass = sum(part for part, _ in parts)
    if mass <= 0.0:
        return None
    x, y, z = (sum(part * at[i] for part, at in parts) / mass for i in range(3))
    return Payload.of(mass, (x, y, z))
