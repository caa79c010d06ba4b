"""Tool and mounting according to the installation: TCP, payload, gravity.

A program may change all of these; loading an installation file sets them again.
"""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from emulator.snapshot import Marked, Snapshot, plausible
from urproto.robots.model import UPRIGHT_GRAVITY
from urproto.robots.pose import Pose
from urproto.vectors import ZERO3, ZERO6, Vector3, Vector6, lerp, scaled_sum3, sub, sub3
from urscript.polyscope.installation_file import InstallationFile

_STANDING: Final = ZERO3
_NO_TCP: Final = ZERO6
_PAYLOAD_DENSITY: Final = 1000.0  # kg/m3: Script Manual, set_payload assumes a sphere of 1 g/cm3


@dataclass(frozen=True, slots=True)
class Payload:
    """Payload on the flange. ``cog``: from the flange [m]; ``inertia``: at the centre of
    gravity, flange axes, Ixx, Iyy, Izz, Ixy, Ixz, Iyz [kg m2]."""

    mass: float = 0.0
    cog: Vector3 = ZERO3
    inertia: Vector6 = ZERO6

    @classmethod
    def of(cls, mass: float, cog: Vector3, inertia: Vector6 | None = None) -> "Payload":
        """Create a payload; without an inertia, it counts as a sphere of water."""
        return cls(mass, cog, inertia if inertia is not None else _sphere_inertia(mass))

    def has_same_weight(self, other: "Payload") -> bool:
        """Whether both have the same weight and centre of gravity, so that they cannot be told apart at rest."""
        return self.mass == other.mass and self.cog == other.cog

    def towards(self, target: "Payload", alpha: float) -> "Payload":
        """Linear interpolation: 0 is this payload, 1 the target."""
        return Payload(
            self.mass + alpha * (target.mass - self.mass),
            scaled_sum3(self.cog, 1.0, sub3(target.cog, self.cog), alpha),
            lerp(self.inertia, sub(target.inertia, self.inertia), alpha),
        )


@dataclass(slots=True)
class _Transition:
    start: Payload
    target: Payload
    duration_s: float
    elapsed_s: float = 0.0


@dataclass
class Installation(Marked):
    """Tool and mounting in use. ``tcp``: flange to TCP pose. ``gravity``: as in set_gravity,
    base frame, upright (0, 0, 9.82) [m/s2]. ``base_acceleration``: of a moving base, base frame [m/s2].
    ``file``: the installation file's settings for programs. ``path``: of that file, None before one was loaded.
    ``cog_follows_tcp``: the payload was set without a centre of gravity, which is therefore the TCP, also the next."""

    name: str = "default.installation"
    path: Path | None = None
    tcp: Pose = _NO_TCP
    payload: Payload = field(default_factory=Payload)
    gravity: Vector3 = UPRIGHT_GRAVITY
    base_acceleration: Vector3 = _STANDING
    file: InstallationFile = field(default_factory=InstallationFile)
    cog_follows_tcp: bool = False
    _transition: _Transition | None = None

    @property
    def target_payload(self) -> Payload:
        """Target of a payload transition; the payload itself if none is in progress."""
        return self._transition.target if self._transition else self.payload

    def set_tcp(self, tcp: Pose) -> None:
        """Set another TCP, and with it the centre of gravity of a payload that was set without one.

        Script Manuals CB3 3.15.4 and 5.12, set_payload. Raises ValueError for implausible numbers.
        """
        if not plausible(*tcp):
            raise ValueError(f"the TCP is implausible: {list(tcp)}")
        self.tcp = tcp
        if self.cog_follows_tcp:
            self.payload = replace(self.payload, cog=tcp[:3])

    def set_payload(self, payload: Payload, transition_s: float = 0.0) -> None:
        """Set another payload, immediately or by a linear transition. A later call replaces an earlier one.

        Raises ValueError for implausible numbers.
        """
        self.cog_follows_tcp = False
        if not plausible(payload.mass, *payload.cog, *payload.inertia):
            raise ValueError(f"the payload is implausible: {payload}")
        self._transition = None
        if transition_s > 0.0:
            self._transition = _Transition(self.payload, payload, transition_s)
        else:
            self.payload = payload

    def advance(self, period_s: float) -> None:
        """One control period of a payload transition."""
        moving = self._transition
        if moving is None:
            return
        moving.elapsed_s += period_s
        if moving.elapsed_s >= moving.duration_s:
            self.payload, self._transition = moving.target, None
        else:
            self.payload = moving.start.towards(moving.target, moving.elapsed_s / moving.duration_s)

    def apply(self, path: Path, file: InstallationFile) -> None:
        self.name, self.path, self.file = path.name, path, file
        self.use_tcp()
        self.use_mounting()
        self.use_payload()

    def use_tcp(self) -> None:
        if self.file.tcp is not None:
            self.tcp = self.file.tcp

    def use_mounting(self) -> None:
        if self.file.gravity is not None:
            self.gravity = self.file.gravity

    def use_payload(self) -> None:
        if self.file.payload is not None:
            payload = self.file.payload
            self.set_payload(Payload.of(payload.mass, payload.cog, payload.inertia))

    def publish(self, snapshot: Snapshot) -> None:
        """Write payload and mounting to a snapshot, if they have changed since the last one."""
        if not self.take_change():
            return
        payload = self.payload
        snapshot.payload, snapshot.payload_cog, snapshot.payload_inertia = payload.mass, payload.cog, payload.inertia
        snapshot.target_gravity = self.gravity
        snapshot.target_base_acceleration = (*self.base_acceleration, 0.0, 0.0, 0.0)


def _sphere_inertia(mass: float) -> Vector6:
    radius = (3.0 * max(mass, 0.0) / (4.0 * math.pi * _PAYLOAD_DENSITY)) ** (1.0 / 3.0)
    moment = 0.4 * mass * radius * radius
    return (moment, moment, moment, 0.0, 0.0, 0.0)
