"""The fields of program nodes: the settings a user can change, and how a file stores them.

Values are as PolyScope shows them (mm, mm/s, degrees per second). A field converts them to the units of the file (m,
m/s, rad/s), and does not touch the file when the shown value is unchanged.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias

from urproto.vectors import is_number
from urscript.polyscope.document import Element, check_text, make
from urscript.polyscope.expressions import expression_of, expression_shown
from urscript.polyscope.numbers import double_text, number
from urscript.polyscope.surroundings import FEATURE_TITLES, PIN_COUNTS, FieldError, Surroundings, check_name
from urscript.polyscope.tree import tag_of
from urscript.polyscope.writer import PINS, find_pin

Value: TypeAlias = str | float | int | bool | None

# fields

Reading: TypeAlias = Callable[[Element, Surroundings], Value]
Writing: TypeAlias = Callable[[Element, Any, Surroundings], None]

# conversions between shown values and the file
MILLI: Final = 1e-3
DEGREES: Final = math.pi / 180
_DIGITS: Final = 9  # decimals shown; more would only show rounding errors of the conversion


def _always(_: Element) -> bool:
    return True


@dataclass(frozen=True, slots=True)
class Field:
    """A setting of a node.

    kind: number, integer, text, choice, boolean, variable, expression, pin, position, tcp, payload, feature, subprogram
    or file. unit, low, high: of numbers. choices: values and titles to choose from. options: the choices when they
    depend on the program. shown: whether the field applies to the node in its current state. optional: it may be empty
    (None).
    """

    key: str
    title: str
    kind: str
    read: Reading
    write: Writing
    unit: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[tuple[str, str], ...] = ()
    options: Callable[[Surroundings], Sequence[str]] | None = None
    shown: Callable[[Element], bool] = _always
    optional: bool = False
    help: str = ""

    def value(self, element: Element, program: Surroundings) -> Value:
        """The current value, as shown to the user."""
        return self.read(element, program)

    def set(self, element: Element, value: Any, program: Surroundings) -> None:
        """Set the value. Raises FieldError for an invalid one."""
        shown = self.read(element, program)
        if value == shown:
            return
        value = self.checked(value, program)
        if value != shown:
            self.write(element, value, program)

    def checked(self, value: Any, program: Surroundings) -> Value:
        """Check and convert a value. Raises FieldError for an invalid one."""
        if value is None or (value == "" and self.kind not in ("text", "expression", "choice")):
            if self.optional:
                return None
            raise FieldError("a value is required")
        if self.kind == "boolean":
            if not isinstance(value, bool):
                raise FieldError(f"must be true or false, not {value!r}")
            return value
        if self.kind in ("number", "integer"):
            return self._number(value)
        if not isinstance(value, str):
            raise FieldError(f"must be text, not {value!r}")
        check_text(value)
        if self.kind == "choice" and value not in (allowed := [choice for choice, _ in self.choices]):
            raise FieldError(f"must be one of {', '.join(allowed)}, not {value!r}")
        return value

    def _number(self, value: Any) -> float | int:
        given = value
        if isinstance(value, str):
            try:
                given = float(value.strip())
            except ValueError:
                given = None
        if not is_number(given):
            raise FieldError(f"must be a number{f' in {self.unit}' if self.unit else ''}, not {value!r}")
        low, high = self.low, self.high
        if (low is not None and given < low) or (high is not None and given > high):
            unit = f" {self.unit}" if self.unit else ""
            span = f"{_shown(low)} to {_shown(high)}" if None not in (low, high) else ""
            span = span or (f"{_shown(low)} or more" if low is not None else f"at most {_shown(high)}")
            raise FieldError(f"{_shown(given)}{unit} is outside the limits: {span}{unit}")
        if self.kind == "integer":
            if given != int(given):
                raise FieldError(f"must be a whole number, not {_shown(given)}")
            return int(given)
        return float(given)

    def description(self, element: Element, program: Surroundings) -> dict[str, Any]:
        """The field and its value, ready for JSON."""
        choices = [{"value": value, "title": title} for value, title in self.choices]
        if self.options is not None:
            choices = [{"value": value, "title": value} for value in self.options(program)]
        return {
            "key": self.key,
            "title": self.title,
            "kind": self.kind,
            "unit": self.unit,
            "low": self.low,
            "high": self.high,
            "choices": choices,
            "optional": self.optional,
            "help": self.help,
            "value": self.value(element, program),
        }


def _shown(value: float | None) -> str:
    return "" if value is None else f"{value:g}"


def _from_file(text: str, factor: float) -> float | None:
    return round(number(text) / factor, _DIGITS) if text.strip() else None


def _to_file(value: float | None, factor: float, digits: bool) -> str | None:
    if value is None:
        return None
    scaled = math.radians(value) if factor == DEGREES else value * factor if factor == 1.0 else value / (1 / factor)
    return double_text(scaled) if digits else str(int(scaled))


def having(attribute: str, *values: str) -> Callable[[Element], bool]:
    """Whether an attribute of a node has one of these values."""
    return lambda element: element.get(attribute) in values


def of_type(*types: str) -> Callable[[Element], bool]:
    """Whether a node's attribute ``type`` has one of these values."""
    return having("type", *types)


def attribute_number(
    key: str, title: str, attribute: str, *, unit: str = "", factor: float = 1.0, whole: bool = False, **more: Any
) -> Field:
    """A number stored as an attribute. factor: from the shown value to that in the file."""

    def read(element: Element, _: Surroundings) -> Value:
        value = _from_file(element.get(attribute), factor)
        return int(value) if whole and value is not None else value

    def write(element: Element, value: float | None, program: Surroundings) -> None:
        program.set_attribute(element, attribute, _to_file(value, factor, not whole))

    return Field(key, title, "integer" if whole else "number", read, write, unit=unit, **more)


def child_number(key: str, title: str, tag: str, *, unit: str = "", factor: float = 1.0, **more: Any) -> Field:
    """A number stored as the text of a child."""

    def read(element: Element, _: Surroundings) -> Value:
        child = element.child(tag)
        return _from_file(child.text if child else "", factor)

    def write(element: Element, value: float | None, program: Surroundings) -> None:
        program.set_text(element, tag, _to_file(value, factor, True))

    return Field(key, title, "number", read, write, unit=unit, **more)


def in_child(tag: str, field: Field) -> Field:
    """The field of a child of the node, which is created with its first value."""

    def read(element: Element, program: Surroundings) -> Value:
        child = element.child(tag)
        return field.read(child, program) if child is not None else None

    def write(element: Element, value: Any, program: Surroundings) -> None:
        field.write(own_child(element, tag, program), value, program)

    return replace(field, read=read, write=write)


def own_child(element: Element, tag: str, program: Surroundings) -> Element:
    """A child of a node, which is created if it is missing."""
    child = element.child(tag)
    if child is None:
        child = make(tag)
        program.set_child(element, tag, child)
    return child


def attribute_text(key: str, title: str, attribute: str, *, empty: bool = True, **more: Any) -> Field:
    """A text stored as an attribute. empty: keep the attribute when the text is empty."""

    def write(element: Element, value: str, program: Surroundings) -> None:
        program.set_attribute(element, attribute, value if value or empty else None)

    return Field(key, title, "text", lambda element, _: element.get(attribute), write, **more)


def attribute_choice(
    key: str, title: str, attribute: str, choices: dict[str, str], choose: Writing | None = None, **more: Any
) -> Field:
    """A choice stored as an attribute. choices: value and title. choose: sets it, and what else depends on it."""

    def write(element: Element, value: str, program: Surroundings) -> None:
        program.set_attribute(element, attribute, value)

    shown = tuple(choices.items())
    return Field(key, title, "choice", lambda e, _: e.get(attribute), choose or write, choices=shown, **more)


def parts_choice(
    key: str,
    title: str,
    attribute: str,
    choices: dict[str, str],
    parts: Mapping[str, Sequence[Element]],
    attributes: Mapping[str, Mapping[str, str]] | None = None,
    keep: Sequence[str] = (),
) -> Field:
    """A choice on which the children of a node depend. parts: those that files have for each value, as they are at
    first. attributes: the same, if attributes depend on it as well. keep: what does not depend on it."""

    def choose(element: Element, value: str, program: Surroundings) -> None:
        for child in list(element.resolved().children):
            if child.tag not in keep:
                program.set_child(element, child.tag, None)
        for name in list(element.resolved().attributes) if attributes is not None else ():
            if name not in (attribute, *keep):
                program.set_attribute(element, name, None)
        program.set_attribute(element, attribute, value)
        for name, given in (attributes or {}).get(value, {}).items():
            program.set_attribute(element, name, given)
        for part in parts.get(value, ()):
            program.set_child(element, part.tag, make(part.tag, text=part.text, **part.attributes))

    return attribute_choice(key, title, attribute, choices, choose)


def attribute_boolean(
    key: str, title: str, attribute: str, *, values: tuple[str, str] = ("false", "true"), **more: Any
) -> Field:
    """A boolean stored as an attribute. values: those in the file for false and true."""

    def write(element: Element, value: bool, program: Surroundings) -> None:
        program.set_attribute(element, attribute, values[value])

    return Field(key, title, "boolean", lambda element, _: element.get(attribute) == values[1], write, **more)


def node_name(*, what: str, free: bool = False) -> Field:
    """The name of a node. free: any text is allowed, as for folders."""

    def write(element: Element, value: str, program: Surroundings) -> None:
        if not value.strip():
            raise FieldError("a name is required")
        if not free:
            check_name(value, what)
        if not free and what != "waypoint" and value in program.names(tag_of(element)):
            raise FieldError(f"there is already a {what} called {value!r}")
        program.set_attribute(element, "name", value)

    return Field("name", "Name", "text", lambda element, _: element.get("name"), write)


def variable_field(key: str, title: str, tag: str = "variable", **more: Any) -> Field:
    """A variable of the program, which is created if it is new, or of the installation."""

    def read(element: Element, _: Surroundings) -> Value:
        child = element.child(tag)
        return (child.get("name") or child.get("featureName") or None) if child else None

    def write(element: Element, value: str | None, program: Surroundings) -> None:
        program.set_child(element, tag, program.variable(value, tag) if value else None)

    return Field(key, title, "variable", read, write, options=Surroundings.variables, optional=True, **more)


def pin_field(key: str, title: str, kinds: Sequence[str], **more: Any) -> Field:
    """An input or output of certain kinds, given by its name or as ``digital_out[0]``."""

    def write(element: Element, value: str | None, program: Surroundings) -> None:
        if value is None:
            program.set_child(element, "pin", None)
            return
        found = find_pin(value, program.installation.pins)
        if found is None or (found[0] in PINS and int(found[1]) >= PIN_COUNTS[found[0]]):
            raise FieldError(f"there is no input or output called {value!r}")
        if found[0] not in kinds:
            raise FieldError(f"{value} cannot be used here: choose one of {', '.join(kinds)}")
        program.set_child(element, "pin", program.named("pin", value))

    def options(program: Surroundings) -> Sequence[str]:
        return program.pins(kinds)

    return Field(key, title, "pin", lambda e, _: e.named("pin") or None, write, options=options, optional=True, **more)


def feature_names(program: Surroundings) -> list[str]:
    """The features that a program may use, as PolyScope shows them."""
    return [*FEATURE_TITLES.values(), *sorted(set(program.installation.features) - set(FEATURE_TITLES))]


def feature_field(key: str, title: str, *, declared: bool = False, **more: Any) -> Field:
    """A feature of the installation, or the base or tool."""

    def read(element: Element, _: Surroundings) -> Value:
        name = element.named("feature")
        return FEATURE_TITLES.get(name, name) or None

    def write(element: Element, value: str | None, program: Surroundings) -> None:
        if value is None:
            program.set_child(element, "feature", None)
            return
        if value not in feature_names(program):
            raise FieldError(f"the installation {program.installation.name} has no feature called {value!r}")
        name = next((inner for inner, shown in FEATURE_TITLES.items() if shown == value), value)
        program.set_child(element, "feature", program.feature(name, declared=declared))

    return Field(key, title, "feature", read, write, options=feature_names, **more)


def expression_field(key: str, title: str, **more: Any) -> Field:
    """An expression."""

    def read(element: Element, _: Surroundings) -> str:
        return expression_shown(element.child("expression"))

    def write(element: Element, value: str, program: Surroundings) -> None:
        program.set_child(element, "expression", expression_of(value, program))

    return Field(key, title, "expression", read, write, **more)


def titled(title: str, text: str) -> str:
    """The line of a node in the tree: its kind and its text."""
    return f"{title} {text}" if text else title
