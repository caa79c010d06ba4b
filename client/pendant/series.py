"""The signals that can be plotted: all numbers of the RTDE outputs, elements of vectors and bits of I/O words."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from urproto.joints import JOINT_TITLES
from urproto.rtde.fields import OUTPUT_FIELDS, Field, FieldType, available_fields
from urproto.signals import DIGITAL_GROUPS
from urproto.versions import PolyscopeVersion

_POSE_ELEMENTS: Final = ("X", "Y", "Z", "RX", "RY", "RZ")
_INERTIA_ELEMENTS: Final = ("Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
_MIXED_UNITS: Final = (
    "m rad",
    "m/s rad/s",
    "m/s2 rad/s2",
    "N Nm",
)  # three elements have the first unit, three the second
_SCREEN_UNITS: Final = {  # unit -> unit in PolyScope, and conversion factor
    "rad": ("°", 57.29577951308232),
    "rad/s": ("°/s", 57.29577951308232),
    "rad/s2": ("°/s²", 57.29577951308232),
    "m": ("mm", 1000.0),
    "m/s": ("mm/s", 1000.0),
    "m/s2": ("m/s²", 1.0),
    "degC": ("°C", 1.0),
    "kg m2": ("kg m²", 1.0),
}
_DIGITAL_SIGNALS: Final = tuple(  # of the words of digital signals: name, number of signals
    (f"{group.letter}{{}}{index}", group.bit(index)) for group in DIGITAL_GROUPS for index in range(group.count)
)
_DIGITAL_WORDS: Final = {"actual_digital_input_bits": "I", "actual_digital_output_bits": "O"}


@dataclass(frozen=True, slots=True)
class Series:
    """One number over time: element ``index`` of an RTDE output, or one ``bit`` of it.

    unit: in RTDE. shown_unit: on a screen, converted by ``factor``.
    """

    field: str
    index: int
    label: str
    unit: str
    shown_unit: str
    factor: float
    doc: str
    bit: int | None = None
    steps: bool = False

    @property
    def key(self) -> str:
        """Name as in Python: ``actual_q[2]``; ``actual_digital_output_bits>>3`` for a bit."""
        if self.bit is not None:
            return f"{self.field}>>{self.bit}"
        return f"{self.field}[{self.index}]" if OUTPUT_FIELDS[self.field].type.count > 1 else self.field


def catalogue(version: PolyscopeVersion | None) -> dict[str, Series]:
    """All signals of a controller of this version, by key; of any version if it is unknown."""
    fields = OUTPUT_FIELDS if version is None else available_fields(OUTPUT_FIELDS, version)
    return {series.key: series for field in fields.values() for series in _split(field)}


def series(*keys: str) -> list[Series]:
    """The signals with these keys. Raises KeyError."""
    return [_ALL[key] for key in keys]


def _split(field: Field) -> Iterator[Series]:
    count, steps = field.type.count, field.type.letter != "d"
    names = _element_names(field)
    for index in range(count):
        unit = _unit(field, index)
        shown, factor = _SCREEN_UNITS.get(unit, (unit, 1.0))
        label = f"{field.name} {names[index]}" if count > 1 else field.name
        yield Series(field.name, index, label, unit, shown, factor, field.doc, steps=steps)
    for pattern, bit in _DIGITAL_SIGNALS if field.name in _DIGITAL_WORDS else ():
        name = pattern.format(_DIGITAL_WORDS[field.name])
        yield Series(field.name, 0, name, "", "", 1.0, f"digital signal {name}", bit, steps=True)


def _unit(field: Field, index: int) -> str:
    if field.unit in _MIXED_UNITS:
        return field.unit.split(" ")[index // 3]
    return field.unit


def _element_names(field: Field) -> tuple[str, ...]:
    if field.type is FieldType.VECTOR3D or field.unit in _MIXED_UNITS:
        return _POSE_ELEMENTS
    return _INERTIA_ELEMENTS if field.name == "payload_inertia" else JOINT_TITLES


_ALL: Final = catalogue(None)


def _vector(name: str, count: int = 6) -> tuple[str, ...]:
    return tuple(f"{name}[{index}]" for index in range(count))


PRESETS: Final[dict[str, tuple[str, ...]]] = {
    "Joint angles": _vector("actual_q"),
    "Joint speeds": _vector("actual_qd"),
    "Joint currents": _vector("actual_current"),
    "Joint temperatures": _vector("joint_temperatures"),
    "TCP position": _vector("actual_TCP_pose", 3),
    "TCP speed": _vector("actual_TCP_speed", 3),
    "TCP force": _vector("actual_TCP_force", 3),
    "TCP torque": _vector("actual_TCP_force")[3:],
    "Speed": ("speed_scaling", "target_speed_fraction"),
    "Digital outputs": tuple(f"actual_digital_output_bits>>{bit}" for bit in range(8)),
    "Digital inputs": tuple(f"actual_digital_input_bits>>{bit}" for bit in range(8)),
}
"""Common selections of signals: name -> keys."""
