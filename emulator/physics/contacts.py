"""Which geoms of a scene can touch, and the stiffness of their contacts.

The solver's stiffness is relative to mass: a force grows with the mass that it has to stop. That is suitable between
objects of the scene, and between them and the tool: light parts are not flung away, and held ones hardly give. Links
have a practically infinite mass (`emulator.physics.arm_bodies`), so their stiffness is set to a value in newtons per
metre.
"""

from enum import Enum, auto
from typing import Any, Final

from urproto.compat import IntEnum

_IMPEDANCE: Final = 0.99
_STIFFNESS_N_M: Final = 20_000.0  # of links against fixed objects, as in emulator.world.shapes (guess)
_DAMPING_N_S_M: Final = 200.0  # guess
_TIME_CONSTANT_S: Final = 0.005  # of contacts; where that is less than two steps, MuJoCo uses two steps instead


class Kind(Enum):
    """Kind of object that a geom belongs to."""

    FREE = auto()  # moves freely or by joints
    STAYING = auto()
    TOOL = auto()  # wrist 3, and everything mounted on it
    LINK = auto()
    BASE = auto()  # base and shoulder, which are on fixed objects


class _Bit(IntEnum):
    FREE = 1
    STAYING = 2
    ARM = 4
    BASE = 8


_ALL: Final = int(_Bit.FREE | _Bit.STAYING | _Bit.ARM | _Bit.BASE)
# contype and conaffinity: geoms touch where one's type is among the other's affinity; the arm does not touch itself
_BITS: Final = {
    Kind.FREE: (int(_Bit.FREE), _ALL),
    Kind.STAYING: (int(_Bit.STAYING), int(_Bit.FREE | _Bit.ARM)),
    Kind.TOOL: (int(_Bit.ARM), int(_Bit.FREE | _Bit.STAYING)),
    Kind.LINK: (int(_Bit.ARM), int(_Bit.FREE | _Bit.STAYING)),
    Kind.BASE: (int(_Bit.BASE), int(_Bit.FREE)),
}
# of two touching geoms, the parameters of the one with higher priority apply; equal ones are mixed
_PRIORITY: Final = {Kind.STAYING: 0, Kind.TOOL: 0, Kind.BASE: 0, Kind.LINK: 1, Kind.FREE: 2}


def touching(kind: Kind, friction: float, mass_kg: float = 1.0) -> dict[str, Any]:
    """Contact parameters of a geom. ``mass_kg``: of a link."""
    contype, conaffinity = _BITS[kind]
    share = mass_kg * _IMPEDANCE
    link = kind is Kind.LINK
    return {
        "contype": contype,
        "conaffinity": conaffinity,
        "priority": _PRIORITY[kind],
        "condim": 4,  # with torsional friction: an object held at one point does not spin
        "friction": [friction, 0.005, 0.0001],
        "solref": [-_STIFFNESS_N_M / share, -_DAMPING_N_S_M / share] if link else [_TIME_CONSTANT_S, 1.0],
        "solimp": [_IMPEDANCE if link else 0.95, _IMPEDANCE, 0.001, 0.5, 2.0],
    }


def classify(geom: Any, *, staying: bool) -> None:
    """Set what a geom of a scene file can touch, unless the file says so."""
    if geom.contype != 1 or geom.conaffinity != 1:
        return
    kind = Kind.STAYING if staying else Kind.FREE
    geom.contype, geom.conaffinity = _BITS[kind]
    if geom.priority == 0:
        geom.priority = _PRIORITY[kind]
