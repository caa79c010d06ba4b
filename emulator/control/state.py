"""Verbs about what the robot is and has: looking at it, and setting it without a program."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, Final

from emulator.control.snapshots import restore_state, save_state
from emulator.control.verbs import BadArguments, NotPossible, Verbs, verb
from emulator.robot.installation import Payload
from emulator.snapshot import Snapshot, plausible
from urproto.compat import IntEnum, IntFlag
from urproto.vectors import ZERO3, Vector3, Vector6

_FIELDS: Final = tuple(field.name for field in fields(Snapshot) if field.name != "messages")


class StateVerbs(Verbs):
    """Verbs about the state as a whole, the arm and its load."""

    @verb
    def state(self, names: Sequence[str] = ()) -> dict[str, Any]:
        """What the controller published in its last period, by RTDE field name.

        All of it, or the fields of these names. Angles in rad, poses in m and rad (rotation vector), in the base
        frame; modes by name.
        """
        unknown = [name for name in names if name not in _FIELDS]
        if unknown:
            raise BadArguments(f"unknown fields {', '.join(unknown)}: known are {', '.join(_FIELDS)}")
        snapshot = self.controller.snapshot
        return {name: _plain(getattr(snapshot, name)) for name in names or _FIELDS}

    @verb
    def describe(self) -> dict[str, str]:
        """What this robot is: model, PolyScope version, serial number."""
        controller = self.controller
        return {
            "model": controller.model.name,
            "title": controller.model.title,
            "polyscope": str(controller.version),
            "serial_number": controller.serial_number,
        }

    @verb
    def set_joints(self, q_rad: Vector6) -> None:
        """Place the arm at these joint angles at once, base to wrist 3 [rad]. It must stand still."""
        try:
            self.controller.motion.set_position(q_rad)
        except ValueError as error:
            raise NotPossible(str(error)) from error

    @verb
    def set_tcp(self, pose: Vector6) -> None:
        """Use another TCP: its pose in the flange frame, x, y, z [m], rx, ry, rz [rad]."""
        try:
            self.controller.set_tcp(pose)
        except ValueError as error:
            raise BadArguments(str(error)) from error

    @verb
    def set_payload(self, mass_kg: float, cog_m: Vector3 = ZERO3) -> None:
        """Set another payload: mass and centre of gravity in the flange frame."""
        if mass_kg < 0.0:
            raise BadArguments(f"a payload of {mass_kg} kg: a mass cannot be negative")
        try:
            self.controller.installation.set_payload(Payload.of(mass_kg, cog_m))
        except ValueError as error:
            raise BadArguments(str(error)) from error

    @verb
    def set_gravity(self, acceleration_m_s2: Vector3) -> None:
        """Mount the robot another way: the acceleration its base senses, (0, 0, 9.82) when it stands upright."""
        if not plausible(*acceleration_m_s2):
            raise BadArguments(f"no base senses {list(acceleration_m_s2)} m/s2")
        self.controller.installation.gravity = acceleration_m_s2

    @verb
    def set_speed_slider(self, fraction: float) -> None:
        """Move the speed slider, 0 to 1."""
        if not 0.0 <= fraction <= 1.0:
            raise BadArguments(f"the speed slider goes from 0 to 1, not to {fraction}")
        self.controller.speed.set_slider(fraction)

    @verb
    def save(self) -> dict[str, Any]:
        """The whole state of a robot at rest as a document that ``restore`` takes; no program may run."""
        return save_state(self.controller)

    @verb
    def restore(self, document: Mapping[str, Any]) -> None:
        """Bring the robot into the state that ``save`` wrote. It must be of the same model and series, at rest."""
        restore_state(self.controller, document)


def _plain(value: Any) -> Any:
    """As JSON has it: names for modes, lists for vectors, hexadecimal text for bytes."""
    if isinstance(value, IntEnum) and not isinstance(value, IntFlag):
        return value.name
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, bytes):
        return value.hex()
    return value if isinstance(value, bool | int | float | str) else str(value)
