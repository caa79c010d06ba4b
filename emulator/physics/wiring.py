"""Wiring between the robot's signals and a scene: conveyors, barriers, buttons, cylinders, lamps, tools.

In each period, outputs act on the scene before its steps, and inputs are set according to it afterwards.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

from emulator.devices.robotiq import Gripper
from emulator.io.encoders import Encoders
from emulator.io.signals import Signals
from emulator.physics.description import Barrier, Conveyor, Parallel
from emulator.physics.fingers import Fingers
from emulator.physics.holders import SuctionCup, ToolChanger

if TYPE_CHECKING:
    from emulator.physics.plan import PhysicsPlan
    from emulator.physics.scene import Scene

_HALF: Final = 0.5  # fraction of its stroke from which a button counts as pressed
_DARK: Final = 0.25  # fraction of a lamp's colour while it is off
_CLOSED_M: Final = 0.002  # width of jaws that are closed without an object (guess)


def level(signals: Signals, output: int) -> bool:
    """Level of a digital output, numbered as in `description`."""
    return bool(signals.digital_outputs >> output & 1)


def _set(signals: Signals, number: int, high: bool) -> None:
    mask = 1 << number
    inputs = signals.digital_inputs
    if bool(inputs & mask) != high:  # otherwise all signals would be published again
        signals.digital_inputs = inputs ^ mask


class Belt:
    """A conveyor. ``jammed``: it stands regardless of its output."""

    def __init__(self, geom: int, conveyor: Conveyor) -> None:
        self._geom, self.conveyor = geom, conveyor
        self.jammed = False

    def act(self, model: Any, signals: Signals, encoders: Encoders) -> None:
        conveyor = self.conveyor
        runs = not self.jammed and (conveyor.output is None or level(signals, conveyor.output))
        speed = conveyor.speed if runs else 0.0
        model.geom_surfacevel[self._geom, 0] = speed
        if conveyor.encoder is not None:
            encoders[conveyor.encoder].simulated_speed = speed * conveyor.ticks_per_m


class Jaw:
    """A gripper on an output."""

    def __init__(self, fingers: Fingers, parallel: Parallel) -> None:
        self.fingers, self._parallel = fingers, parallel
        self._goal = fingers.shape.stroke

    def act(self, data: Any, signals: Signals, period_s: float) -> None:
        parallel = self._parallel
        self._goal = 0.0 if level(signals, parallel.output) else parallel.stroke
        self.fingers.move(data, self._goal, 2.0 * parallel.speed, parallel.force, period_s)

    def update(self, data: Any, signals: Signals, period_s: float) -> None:
        self.fingers.update(data, self._goal, period_s)
        parallel = self._parallel
        if parallel.holding is not None:
            _set(signals, parallel.holding, self._goal == 0.0 and self.fingers.stopped)
        if parallel.closed is not None:
            _set(signals, parallel.closed, self.fingers.width < _CLOSED_M)


class Wires:
    """The wiring of one scene and one robot. ``gripper``: that of ``--gripper``."""

    def __init__(
        self,
        plan: "PhysicsPlan",
        scene: "Scene",
        signals: Signals,
        encoders: Encoders,
        gripper: Gripper | None,
    ) -> None:
        model = scene.model
        self._model, self._signals, self._encoders, self._gripper = model, signals, encoders, gripper
        self.belts = {
            name: Belt(model.geom(name).id, moving.conveyor)
            for name, moving in plan.moving.items()
            if moving.conveyor is not None
        }
        self.cups = {name: SuctionCup(name, cup, model) for name, cup in plan.cups.items()}
        self.changers = [ToolChanger(name, plate, plan.couplings, model) for name, plate in plan.changers.items()]
        self._jaws = [
            Jaw(Fingers(shape, model), shape.parallel) for shape in plan.output_grippers.values() if shape.parallel
        ]
        self._fingers = None if plan.gripper is None or gripper is None else Fingers(plan.gripper, model)
        fingers = [*(jaw.fingers for jaw in self._jaws), *([] if self._fingers is None else [self._fingers])]
        self._keeping: list[Fingers | SuctionCup | ToolChanger] = [*fingers, *self.cups.values(), *self.changers]
        self._barriers = list(plan.barriers.values())
        joints = {name: moving.joint for name, moving in plan.moving.items() if moving.joint is not None}
        self._buttons = [
            (int(model.joint(name).qposadr[0]), joint) for name, joint in joints.items() if joint.input is not None
        ]
        self._drives = [(scene.drives[name], joint) for name, joint in joints.items() if joint.output is not None]
        lamps = {name: moving.lamp for name, moving in plan.moving.items() if moving.lamp is not None}
        self._lamps = [
            (geom, lamp, model.geom_rgba[geom].copy())
            for name, lamp in lamps.items()
            for geom in (model.geom(name).id,)
        ]

    def save(self) -> list[float]:
        """State of grippers, cups and changers in addition to the scene's own, for `restore`."""
        return [value for part in self._keeping for value in part.save()]

    def restore(self, values: Sequence[float]) -> None:
        left = list(values)
        for part in self._keeping:
            count = len(part.save())
            part.restore(left[:count])
            del left[:count]

    def act(self, data: Any, period_s: float) -> None:
        """Let outputs act on the scene."""
        signals = self._signals
        for belt in self.belts.values():
            belt.act(self._model, signals, self._encoders)
        for actuator, joint in self._drives:
            data.ctrl[actuator] = joint.far if level(signals, _number(joint.output)) else 0.0
        for geom, lamp, colour in self._lamps:
            self._model.geom_rgba[geom, :3] = colour[:3] * (1.0 if level(signals, lamp) else _DARK)
        for changer in self.changers:
            changer.act(data, locking=level(signals, changer.changer.output))
        for jaw in self._jaws:
            jaw.act(data, signals, period_s)
        if self._fingers is not None and self._gripper is not None:
            drive = self._gripper.drive
            low, high = self._fingers.shape.force
            goal = None if drive is None else 1e-3 * drive.width_mm
            speed = 0.0 if drive is None else 1e-3 * drive.mm_per_s
            force = high if drive is None else low + (high - low) * drive.force_share
            self._fingers.move(data, goal, speed, force, period_s)

    def step(self, data: Any) -> None:
        """After each of the scene's steps."""
        for cup in self.cups.values():
            cup.act(data, sucking=level(self._signals, cup.suction.output))

    def update(self, data: Any, period_s: float) -> None:
        """Set inputs according to the scene."""
        signals = self._signals
        for barrier in self._barriers:
            _set(signals, barrier.input, _interrupted(self._model, data, barrier))
        for address, joint in self._buttons:
            _set(signals, _number(joint.input), abs(float(data.qpos[address])) > _HALF * abs(joint.far))
        for cup in self.cups.values():
            if cup.suction.vacuum is not None:
                _set(signals, cup.suction.vacuum, bool(cup.holds))
        for changer in self.changers:
            if changer.changer.locked is not None:
                _set(signals, changer.changer.locked, bool(changer.holds(data)))
        for jaw in self._jaws:
            jaw.update(data, signals, period_s)
        if self._fingers is not None and self._gripper is not None:
            drive = self._gripper.drive
            self._fingers.update(data, None if drive is None else 1e-3 * drive.width_mm, period_s)
            self._gripper.set_fingers(1e3 * self._fingers.width, stopped=self._fingers.stopped)


def _number(signal: int | None) -> int:
    assert signal is not None
    return signal


def _interrupted(model: Any, data: Any, barrier: Barrier) -> bool:
    start = np.array(barrier.start)
    way = np.array(barrier.end) - start
    return 0.0 <= float(mujoco.mj_ray(model, data, start, way, None, True, -1, None)) < 1.0
