"""Verbs about the state of the robot: reading it, and setting it without a program."""

from base64 import b64decode
from collections.abc import Mapping, Sequence
from typing import Any, Final

from emulator.control.snapshots import check_document, restore_state, save_state
from emulator.control.verbs import Verbs, refusing, verb
from emulator.robot.installation import Payload
from emulator.snapshot import NAMES, plausible
from urproto.compat import IntEnum, IntFlag
from urproto.controlapi import BadArguments, NotPossible
from urproto.vectors import ZERO3, Vector3, Vector6

_FIELDS: Final = tuple(name for name in NAMES if name != "messages")


class StateVerbs(Verbs):
    """Verbs about the state as a whole, the arm and its load."""

    @verb
    def state(self, names: Sequence[str] = ()) -> dict[str, Any]:
        """The state that the controller published in its last period, by RTDE field name.

        ``names``: the fields to return; all by default. Angles are in rad, poses in m and rad (rotation vector) in the
        base frame; modes are given by name.
        """
        unknown = [name for name in names if name not in _FIELDS]
        if unknown:
            raise BadArguments(f"unknown fields {', '.join(unknown)}: choose from {', '.join(_FIELDS)}")
        snapshot = self.controller.snapshot
        return {name: _plain(getattr(snapshot, name)) for name in names or _FIELDS}

    @verb
    def describe(self) -> dict[str, str]:
        """Describe this robot: model, PolyScope version, serial number."""
        controller = self.controller
        return {
            "model": controller.model.name,
            "title": controller.model.title,
            "polyscope": str(controller.version),
            "serial_number": controller.serial_number,
        }

    @verb
    def set_joints(self, q_rad: Vector6) -> None:
        """Place the arm at these joint angles, base to wrist 3 [rad], without a movement. It must be at rest."""
        with refusing(NotPossible):
            self.controller.motion.set_position(q_rad)

    @verb
    def set_tcp(self, pose: Vector6) -> None:
        """Set the TCP: its pose in the flange frame, x, y, z [m], rx, ry, rz [rad]."""
        with refusing(BadArguments):
            self.controller.set_tcp(pose)

    @verb
    def set_payload(self, mass_kg: float, cog_m: Vector3 = ZERO3) -> None:
        """Set the payload: mass, and centre of gravity in the flange frame."""
        if mass_kg < 0.0:
            raise BadArguments(f"the mass of a payload cannot be negative: {mass_kg} kg")
        with refusing(BadArguments):
            self.controller.installation.set_payload(Payload.of(mass_kg, cog_m))

    @verb
    def set_gravity(self, acceleration_m_s2: Vector3) -> None:
        """Change the mounting: the acceleration that the base senses, (0, 0, 9.82) if the robot stands upright."""
        if not plausible(*acceleration_m_s2):
            raise BadArguments(f"{list(acceleration_m_s2)} m/s2 is out of range for the acceleration of gravity")
        self.controller.installation.gravity = acceleration_m_s2

    @verb
    def set_speed_slider(self, fraction: float) -> None:
        """Set the speed slider, 0 to 1."""
        if not 0.0 <= fraction <= 1.0:
            raise BadArguments(f"the speed slider must be from 0 to 1, not {fraction}")
        self.controller.speed.set_slider(fraction)

    @verb
    def save(self) -> dict[str, Any]:
        """Return the whole state as a document for ``restore``; while a program runs, it contains the robot's run."""
        return save_state(self.controller)

    @verb
    def restore(self, document: Mapping[str, Any]) -> None:
        """Restore a state returned by ``save``. The robot must be of the same model and series.

        It must be at rest, unless the state is one of a running program: then the saved run is executed again, which
        takes time, and a robot with ports restarts, so that its clients have to connect anew.
        """
        check_document(self.controller, document)
        if (journal := document.get("journal")) is None:
            return restore_state(self.controller, document)
        if self._robot.go_on_from is None:
            raise NotPossible("this robot is a replay itself")
        try:
            run = b64decode(journal, validate=True)
        except (TypeError, ValueError) as error:
            raise BadArguments(f"the document's journal is damaged: {error}") from error
        return self._wait(self._robot.go_on_from(run))


def _plain(value: Any) -> Any:
    """A value as JSON: names for modes, lists for vectors, hexadecimal text for bytes."""
    if isinstance(value, IntEnum) and not isinstance(value, IntFlag):
        return value.name
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, bytes):
        return value.hex()
    return value if isinstance(value, bool | int | float | str) else str(value)
