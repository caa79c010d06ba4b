"""Force nodes: the arm is compliant, or applies a force, while the nodes inside run.

As written by PolyScope 5, seen in a public program and the script saved with it: the compliant axes of a feature,
forces and torques along them, the maximum speed of compliant axes, and the maximum deviation of the others from the
path.
"""

from collections.abc import Callable, Iterator
from typing import Final, Literal

from urscript.polyscope.document import DocumentError, Element, make
from urscript.polyscope.forms import DEGREES, MILLI, Field, attribute_choice, feature_field
from urscript.polyscope.numbers import double_text, number
from urscript.polyscope.registry import Kind, empty_children, node, translate_children
from urscript.polyscope.surroundings import Surroundings
from urscript.polyscope.writer import TOOL, Writer
from urscript.work import Steps

_TYPES: Final = {"Simple": 2, "Frame": 2, "Point": 1, "Motion": 3}  # Script Manual, force_mode
_STOP: Final = "5.0"  # m/s2
_AXES: Final = ("X", "Y", "Z", "RX", "RY", "RZ")
_ALONG: Final = 2  # the axis of Simple: z of the feature
_MAX_LIMIT: Final = {"N": 500.0, "Nm": 50.0}  # guess: more than any arm can apply
_DEFAULTS: Final = {
    "selection": "0, 0, 1, 0, 0, 0",
    "wrench": "0.0, 0.0, 0.0, 0.0, 0.0, 0.0",
    "limitsForce": "0.15, 0.15, 0.15, 1.0471975511965976, 1.0471975511965976, 1.0471975511965976",
    "limitsMotion": "0.1, 0.1, 0.1, 0.3490658503988659, 0.3490658503988659, 0.3490658503988659",
}


def _part(element: Element, tag: str, axis: int) -> str:
    child = element.child(tag)
    parts = child.get("value").split(",") if child else []
    return parts[axis].strip() if axis < len(parts) else ""


def _set_part(element: Element, tag: str, axis: int, text: str, program: Surroundings) -> None:
    child = element.child(tag)
    parts = [part.strip() for part in (child.get("value") if child else _DEFAULTS[tag]).split(",")]
    parts[axis] = text
    if child is None:
        program.set_child(element, tag, make(tag, value=", ".join(parts)))
    else:
        program.set_attribute(child, "value", ", ".join(parts))


def _shown(axis: int, what: Literal["any", "yields", "stiff"]) -> Callable[[Element], bool]:
    def shown(element: Element) -> bool:
        if element.get("type") == "Simple" and axis != _ALONG:
            return False
        yields = _part(element, "selection", axis) == "1"
        return what == "any" or yields is (what == "yields")

    return shown


def _compliant(axis: int) -> Field:
    def write(element: Element, value: bool, program: Surroundings) -> None:
        _set_part(element, "selection", axis, "1" if value else "0", program)

    def shown(element: Element) -> bool:
        return element.get("type") != "Simple"  # there it is always z

    key, title = f"{_AXES[axis].lower()}_yields", f"{_AXES[axis]} compliant"
    return Field(key, title, "boolean", lambda e, _: _part(e, "selection", axis) == "1", write, shown=shown)


def _number(
    axis: int, what: str, title: str, tag: str, units: tuple[str, str], when: Literal["yields", "stiff"]
) -> Field:
    """units: along and about an axis. when: whether the field applies to compliant or to stiff axes."""
    unit = units[axis > _ALONG]
    factor = {"mm": MILLI, "mm/s": MILLI, "°": DEGREES, "°/s": DEGREES}.get(unit, 1.0)
    high = _MAX_LIMIT.get(unit)
    low = -high if high is not None else 0.0

    def read(element: Element, _: Surroundings) -> float | None:
        text = _part(element, tag, axis)
        return round(number(text) / factor, 9) if text else None

    def write(element: Element, value: float, program: Surroundings) -> None:
        _set_part(element, tag, axis, double_text(value * factor), program)

    key = f"{_AXES[axis].lower()}_{what}"
    label = f"{_AXES[axis]}: {title}"
    return Field(key, label, "number", read, write, unit=unit, low=low, high=high, shown=_shown(axis, when))


def _fields() -> Iterator[Field]:
    yield attribute_choice("type", "Type", "type", {kind: kind for kind in _TYPES})
    yield feature_field("feature", "Feature", declared=True)
    for axis in range(6):
        yield _compliant(axis)
        yield _number(axis, "force", "force", "wrench", ("N", "Nm"), "yields")
        yield _number(axis, "speed", "maximum speed", "limitsForce", ("mm/s", "°/s"), "yields")
        yield _number(axis, "deviation", "maximum deviation", "limitsMotion", ("mm", "°"), "stiff")


def _new(program: Surroundings) -> Element:
    values = [make(tag, value=value) for tag, value in _DEFAULTS.items()]
    return make("Force", program.feature(TOOL, declared=True), *values, empty_children(), type="Simple")


FORCE: Final = Kind(
    "force",
    "Force",
    "Templates",
    lambda _: "Force",
    new=_new,
    contains="nodes",
    fields=tuple(_fields()),
)


@node("Force", FORCE, attributes="type", children="feature selection wrench limitsForce limitsMotion children")
def force(writer: Writer, element: Element) -> Steps[None]:
    """Run nodes while the arm is compliant or applies a force."""
    kind = _TYPES.get(element.get("type"))
    if kind is None:
        raise DocumentError(f"a Force of unknown type {element.get('type')!r}")
    selection, wrench, by_force, by_motion = (
        _six_parts(element, tag) for tag in ("selection", "wrench", "limitsForce", "limitsMotion")
    )
    frame = writer.feature(element.child("feature"))
    frame = "tool_pose()" if frame == "get_forward_kin()" else frame
    limits = [
        yielding if chosen == "1" else stiff
        for chosen, yielding, stiff in zip(selection, by_force, by_motion, strict=True)
    ]
    writer.label(element, "Force")
    writer.line("sleep(0.02)")
    writer.line("zero_ftsensor()")
    writer.line(f"force_mode({frame}, [{', '.join(selection)}], [{', '.join(wrench)}], {kind}, [{', '.join(limits)}])")
    yield from translate_children(writer, element)
    writer.line("end_force_mode()")
    writer.line(f"stopl({_STOP})")


def _six_parts(element: Element, tag: str) -> list[str]:
    child = element.child(tag)
    parts = [part.strip() for part in child.get("value").split(",")] if child else []
    if len(parts) != 6:
        raise DocumentError(f"a Force lacks its <{tag}>")
    return parts
