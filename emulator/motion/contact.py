"""Contacts of a compliant tool, and their effect in the next control period.

A contact is a spring and a damper along one direction, which push and never pull, and friction across it. If the force
of a stiff spring only took effect in the following period, the tool would enter it at full speed before it pushes, and
leave it faster than it came. The compliant tool therefore looks ahead: its next speed is the one that is consistent
with the contact force at that speed (backward Euler), which dissipates energy at any stiffness and period. Contacts
that are not reached yet (negative depth) are included.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import copysign
from operator import mul

from urproto.robots.model import Joints
from urproto.vectors import Axes, Vector3, as_six, cross, dot, into6, lerp

_EXACT = 1.0 + 1e-9
_ROUNDS = 4  # to determine which contacts will push: usually two suffice


@dataclass(frozen=True, slots=True)
class Contact:
    """Where tool and world touch, or soon will. Vectors in the base frame.

    lever: from the TCP [m]. normal: the direction in which the tool is pushed. depth: penetration of the tool [m],
    negative before it touches. stiffness [N/m], damping [N s/m]. grip: friction force per sliding speed [N s/m].
    force: the present one [N], friction included.
    """

    lever: Vector3
    normal: Vector3
    depth: float
    stiffness: float
    damping: float
    grip: float = 0.0
    force: Vector3 = (0.0, 0.0, 0.0)

    @property
    def wrench(self) -> Joints:
        """The present force, and its torque about the TCP."""
        return (*self.force, *cross(self.lever, self.force))

    def directions(self) -> tuple[Vector3, Vector3, Vector3]:
        """The normal, and two across it."""
        helper = (1.0, 0.0, 0.0) if abs(self.normal[0]) < 0.6 else (0.0, 1.0, 0.0)
        across = cross(self.normal, helper)
        size = dot(across, across) ** 0.5
        across = (across[0] / size, across[1] / size, across[2] / size)
        return self.normal, across, cross(self.normal, across)


@dataclass(frozen=True, slots=True)
class Response:
    """How the tool responds to forces in one period, axis by axis of the task frame.

    speed' = (kept + gain * force) / resistance in compliant axes, and at most ``bound``. given: the speeds of the
    others [m/s, rad/s].
    """

    compliant: tuple[bool, ...]
    resistance: Joints
    kept: Joints
    given: Joints
    bound: Joints
    gain: float


def solve(
    dt: float, axes: Axes, response: Response, wrench: Joints, contacts: Sequence[Contact], alone: Joints
) -> Joints:
    """The tool's speed in the task frame at the end of the period: [m/s, rad/s].

    ``wrench``: everything that acts on the tool except these contacts, in the task frame. ``alone``: the speed that the
    tool would have without the contacts.
    """
    pushing: list[Contact] = []
    rows = [(contact, _generalised(axes, contact)) for contact in contacts]
    speed = alone
    for _ in range(_ROUNDS):
        wanted = [row for row in rows if _will_push(dt, *row, speed, row[0] in pushing)]
        now = [contact for contact, _ in wanted]
        if now == pushing:
            break
        pushing, speed = now, _speed(dt, response, wrench, wanted) if wanted else alone
    return speed


def _generalised(axes: Axes, contact: Contact) -> tuple[Joints, Joints, Joints]:
    """The contact's directions as wrenches of unit force in the task frame: normal first."""
    normal, one, other = (into6(axes, (*d, *cross(contact.lever, d))) for d in contact.directions())
    return normal, one, other


def _will_push(dt: float, contact: Contact, rows: tuple[Joints, Joints, Joints], speed: Joints, pushes: bool) -> bool:
    """Whether the contact acts at the end of the period, if the tool then has this speed."""
    away = float(sum(map(mul, rows[0], speed)))
    depth = contact.depth - dt * away
    return contact.stiffness * depth > contact.damping * away if pushes else depth > 0.0


def _speed(
    dt: float, response: Response, wrench: Joints, pushing: Sequence[tuple[Contact, tuple[Joints, Joints, Joints]]]
) -> Joints:
    """Solve (resistance + gain * sum of contact resistances) speed' = kept + gain * (wrench + springs)."""
    force, resisting = list(wrench), [[0.0] * 6 for _ in range(6)]
    for contact, rows in pushing:
        spring = contact.stiffness * contact.depth
        force = [f + spring * part for f, part in zip(force, rows[0], strict=True)]
        _add(resisting, rows[0], contact.stiffness * dt + contact.damping)
        if contact.grip:
            _add(resisting, rows[1], contact.grip)
            _add(resisting, rows[2], contact.grip)
    bounded: dict[int, float] = {i: response.given[i] for i in range(6) if not response.compliant[i]}
    while True:
        speed = _unbounded(response, force, resisting, bounded)
        beyond = [i for i in range(6) if i not in bounded and abs(speed[i]) > response.bound[i] * _EXACT]
        if not beyond:
            return speed
        worst = max(beyond, key=lambda i: abs(speed[i]) - response.bound[i])
        bounded[worst] = copysign(response.bound[worst], speed[worst])


def _unbounded(
    response: Response, force: Sequence[float], resisting: Sequence[Sequence[float]], fixed: Mapping[int, float]
) -> Joints:
    """Solve the equation of _speed with some speeds fixed."""
    free = [i for i in range(6) if i not in fixed]
    left, right = [], []
    for i in free:
        brake = sum(resisting[i][k] * speed for k, speed in fixed.items())
        right.append(response.kept[i] + response.gain * (force[i] - brake))
        left.append([response.gain * resisting[i][k] + (response.resistance[i] if i == k else 0.0) for k in free])
    speeds = {**fixed, **dict(zip(free, _eliminated(left, right), strict=True))}
    return as_six(speeds[i] for i in range(6))


def _add(matrix: list[list[float]], direction: Joints, resistance: float) -> None:
    for i in range(6):
        part = resistance * direction[i]
        for k in range(6):
            matrix[i][k] += part * direction[k]


def _eliminated(matrix: list[list[float]], right: list[float]) -> list[float]:
    """x of matrix x = right. All pivots are positive: the matrix is positive definite."""
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    for i, pivot in enumerate(rows):
        for row in rows:
            if row is not pivot and row[i]:
                factor = row[i] / pivot[i]
                for k in range(i, len(row)):
                    row[k] -= factor * pivot[k]
    return [row[-1] / row[i] for i, row in enumerate(rows)]


def without(total: Joints, contacts: Sequence[Contact]) -> Joints:
    """A wrench without the present forces of these contacts."""
    for contact in contacts:
        total = lerp(total, contact.wrench, -1.0)
    return total
