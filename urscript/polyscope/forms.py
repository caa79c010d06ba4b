"""What can be set at a node of a program: its fields, how a file holds them, and what they may name.

Values are as PolyScope shows them (mm, mm/s, degrees a second); a field writes what the file has (m, m/s, rad/s) and
leaves the file alone when the value shown is the one there.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from urproto.robots import RobotModel
from urproto.versions import PolyscopeVersion, Series
from urscript.polyscope.document import Changes, Element, check_text, make, sharing
from urscript.polyscope.folder import ProgramsFolder
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.numbers import number
from urscript.polyscope.tree import tag_of
from urscript.polyscope.writer import BASE, PINS, TOOL, find_pin

Value: TypeAlias = str | float | int | bool | None

_FAVOURITES: Final = PolyscopeVersion(5, 13)  # first version whose variables say whether they are favourites (seen)
_FEATURE_REFERENCE: Final = "GeomFeatureReference"
_VARIABLE_TAGS: Final = ("variable", "ProgramVariable", "InstallationVariable", "loopVariable")


ORDERS: Final[dict[str, tuple[Sequence[str], Sequence[str]]]] = {}
"""In which order files have the attributes and the children of a node, by its tag; the registry fills it."""


class FieldError(ValueError):
    """A value that a field cannot take; the text says which ones it can."""


class Surroundings:
    """What the nodes of a program may name, and what has to be known to make one.

    ``version``: of the PolyScope that the program is for. ``model``: the arm, whose dimensions taught positions hold.
    ``folder``: where the files are that nodes name.
    """

    def __init__(
        self,
        root: Element,
        installation: InstallationFile,
        version: PolyscopeVersion,
        model: RobotModel | None = None,
        folder: ProgramsFolder | None = None,
    ) -> None:
        self.root, self.installation, self.version, self.model = root, installation, version, model
        self.folder = folder or ProgramsFolder(None)
        self.changes = Changes()

    @property
    def cb3(self) -> bool:
        """Whether it is a program of the CB3 series."""
        return self.version.series is Series.CB3

    # writing

    def set_attribute(self, element: Element, name: str, value: str | None) -> None:
        """An attribute of a node's, in the place where PolyScope has it."""
        self.changes.set_attribute(element, name, value, _orders(element)[0])

    def set_child(self, element: Element, tag: str, child: Element | None) -> None:
        """A child of a node's, in the place where PolyScope has it."""
        self.changes.set_child(element, tag, child, _orders(element)[1])

    def set_text(self, element: Element, tag: str, text: str | None) -> None:
        """The text of a child of a node's."""
        self.changes.set_text(element, tag, text, _orders(element)[1])

    # what the program has

    def variable_objects(self) -> dict[str, Element]:
        """The variables of the program by their names, those of the installation among them."""
        found: dict[str, Element] = {}
        for place in self.root.places():
            element = place.resolved()
            if place.tag in _VARIABLE_TAGS and "name" in element.attributes and element.child("expression") is None:
                found.setdefault(element.attributes["name"], element)
        return found

    def variables(self) -> list[str]:
        """Names of the variables that the program and the installation have."""
        return sorted({*self.variable_objects(), *self.installation.variables, *self.installation.feature_variables})

    def names(self, tag: str) -> list[str]:
        """Names of the nodes of a kind, in the order of the document."""
        found = (place.get("name") for place in self.root.places() if tag_of(place) == tag)
        return list(dict.fromkeys(name for name in found if name))

    def unused(self, stem: str, taken: Sequence[str]) -> str:
        """``stem`` with the first number behind it that makes a new name of it."""
        used, index = set(taken), 1
        while f"{stem}_{index}" in used:
            index += 1
        return f"{stem}_{index}"

    # what nodes name

    def variable(self, name: str, tag: str = "variable", *, new: bool = True) -> Element:
        """A place that has the variable of a name. Raises FieldError for a name that is none, or unknown."""
        if name in self.installation.feature_variables:
            return make("GeomFeatureVariable" if tag == "ProgramVariable" else tag, featureName=name)
        known = self.variable_objects().get(name)
        if name in self.installation.variables:
            tag = "InstallationVariable" if tag == "ProgramVariable" else tag
            attributes = {"class_": "InstallationVariable"} if tag == "variable" else {}
            return sharing(tag, known, **attributes) if known else make(tag, **attributes, name=name)
        if known is not None:
            return sharing(tag, known)
        if not new:
            raise FieldError(f"there is no variable {name!r} in the program or its installation")
        check_name(name, "variable")
        element = make(tag, make("initializeExpression"), name=name, prefersPersistentValue="false")
        if not self.cb3 and (self.version.major, self.version.minor) >= (_FAVOURITES.major, _FAVOURITES.minor):
            element.attributes["favourite"] = "false"
        return element

    def named(self, tag: str, name: str, **attributes: str) -> Element:
        """A place that has the pin, TCP or feature of a name, which all places of the program share."""
        for place in self.root.places():
            if place.tag == tag and place.get("referencedName") == name:
                return sharing(tag, place, **attributes)
        return make(tag, **attributes, referencedName=name)

    def feature(self, name: str, tag: str = "feature", *, declared: bool = False) -> Element:
        """A place that has a feature. declared: the place holds nothing else, so that the file does not say what."""
        return self.named(tag, name, **({} if declared else {"class_": _FEATURE_REFERENCE}))

    def pins(self, kinds: Sequence[str]) -> list[str]:
        """Names of the inputs or outputs of some kinds (keys of `PINS`, or modbus), as the installation calls them."""
        given = {pin: name for name, pin in self.installation.pins.items()}
        numbered = [(kind, str(index)) for kind in kinds for index in range(_COUNTS.get(kind, 0))]
        names = [given.get(pin, f"{pin[0]}[{pin[1]}]") for pin in numbered]
        return names + [
            name for name, (kind, _) in self.installation.pins.items() if kind == "modbus" and kind in kinds
        ]


_COUNTS: Final = {  # how many of each kind there are
    **dict.fromkeys(("digital_in", "digital_out", "config_in", "config_out"), 8),
    **dict.fromkeys(("tool_in", "tool_out", "analog_in", "analog_out", "tool_analog_in"), 2),
    **dict.fromkeys(("GP_bool_in", "GP_bool_out"), 64),
    **dict.fromkeys(("GP_int_in", "GP_int_out", "GP_float_in", "GP_float_out"), 24),
}
DIGITAL_INPUTS: Final = ("digital_in", "tool_in", "config_in", "GP_bool_in", "modbus")
DIGITAL_OUTPUTS: Final = ("digital_out", "tool_out", "config_out", "GP_bool_out", "modbus")
ANALOG_INPUTS: Final = ("analog_in", "tool_analog_in", "GP_float_in")
ANALOG_OUTPUTS: Final = ("analog_out", "GP_float_out")
OUTPUTS: Final = (*DIGITAL_OUTPUTS, *ANALOG_OUTPUTS, "GP_int_out")


def _orders(element: Element) -> tuple[Sequence[str], Sequence[str]]:
    return ORDERS.get(tag_of(element), ((), ()))


def check_name(name: str, what: str) -> None:
    """Raises FieldError for a name that PolyScope's keyboard does not give."""
    if not name or not (name[0].isalpha() or name[0] == "_") or not all(c.isalnum() or c == "_" for c in name):
        raise FieldError(
            f"{name!r} is no name for a {what}: letters, digits and underscores, not beginning with a digit"
        )


# fields

Reading: TypeAlias = Callable[[Element, Surroundings], Value]
Writing: TypeAlias = Callable[[Element, Any, Surroundings], None]


def _always(_: Element) -> bool:
    return True


@dataclass(frozen=True, slots=True)
class Field:
    """Something that can be set at a node.

    kind: number, integer, text, choice, boolean, variable, expression, pin, position, tcp, payload, feature, subprogram
    or file.
    unit, low, high: of numbers. choices: what can be chosen, value and title; None when it depends on the program.
    shown: whether it has a meaning as the node is now. optional: it may be empty (None).
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
        """What is set, as it is shown."""
        return self.read(element, program)

    def set(self, element: Element, value: Any, program: Surroundings) -> None:
        """Set it. Raises FieldError for what it cannot take."""
        shown = self.read(element, program)
        if value == shown:
            return
        value = self.checked(value, program)
        if value != shown:
            self.write(element, value, program)

    def checked(self, value: Any, program: Surroundings) -> Value:
        """The value, if the field can take it. Raises FieldError."""
        if value is None or (value == "" and self.kind not in ("text", "expression", "choice")):
            if self.optional:
                return None
            raise FieldError("it needs a value")
        if self.kind == "boolean":
            if not isinstance(value, bool):
                raise FieldError(f"it is true or false, not {value!r}")
            return value
        if self.kind in ("number", "integer"):
            return self._number(value)
        if not isinstance(value, str):
            raise FieldError(f"it is a text, not {value!r}")
        check_text(value)
        if self.kind == "choice" and value not in (allowed := [choice for choice, _ in self.choices]):
            raise FieldError(f"it is one of {', '.join(allowed)}, not {value!r}")
        return value

    def _number(self, value: Any) -> float | int:
        given = value
        if isinstance(value, str):
            try:
                given = float(value.strip())
            except ValueError:
                given = None
        if isinstance(given, bool) or not isinstance(given, int | float) or not math.isfinite(given):
            raise FieldError(f"it is a number{f' in {self.unit}' if self.unit else ''}, not {value!r}")
        low, high = self.low, self.high
        if (low is not None and given < low) or (high is not None and given > high):
            unit = f" {self.unit}" if self.unit else ""
            span = f"{_shown(low)} to {_shown(high)}" if None not in (low, high) else ""
            span = span or (f"{_shown(low)} or more" if low is not None else f"at most {_shown(high)}")
            raise FieldError(f"{_shown(given)}{unit} is outside its limits: {span}{unit}")
        if self.kind == "integer":
            if given != int(given):
                raise FieldError(f"it is a whole number, not {_shown(given)}")
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


def java_number(value: float) -> str:
    """A number as Java writes a double: 0.25, 5.0E-4, 1.0E7."""
    if value == 0 or 1e-3 <= abs(value) < 1e7:
        return repr(float(value))
    digits, _, exponent = f"{value!r}".partition("e")
    if not exponent:  # Python begins with exponents later
        exponent = str(math.floor(math.log10(abs(value))))
        digits = repr(float(f"{value!r}e{-int(exponent)}")) if "." in digits else digits
    return f"{digits if '.' in digits else digits + '.0'}E{int(exponent)}"


# the conversions between what is shown and what the file has
MILLI: Final = 1e-3
DEGREES: Final = math.pi / 180
_DIGITS: Final = 9  # behind the point of what is shown; more only show how numbers are converted


def _from_file(text: str, factor: float) -> float | None:
    return round(number(text) / factor, _DIGITS) if text.strip() else None


def _to_file(value: float | None, factor: float, digits: bool) -> str | None:
    if value is None:
        return None
    scaled = math.radians(value) if factor == DEGREES else value * factor if factor == 1.0 else value / (1 / factor)
    return java_number(scaled) if digits else str(int(scaled))


def attribute_number(
    key: str, title: str, attribute: str, *, unit: str = "", factor: float = 1.0, whole: bool = False, **more: Any
) -> Field:
    """A number that is an attribute. factor: from what is shown to what the file has."""

    def read(element: Element, _: Surroundings) -> Value:
        value = _from_file(element.get(attribute), factor)
        return int(value) if whole and value is not None else value

    def write(element: Element, value: float | None, program: Surroundings) -> None:
        program.set_attribute(element, attribute, _to_file(value, factor, not whole))

    return Field(key, title, "integer" if whole else "number", read, write, unit=unit, **more)


def child_number(key: str, title: str, tag: str, *, unit: str = "", factor: float = 1.0, **more: Any) -> Field:
    """A number that is the text of a child."""

    def read(element: Element, _: Surroundings) -> Value:
        child = element.child(tag)
        return _from_file(child.text if child else "", factor)

    def write(element: Element, value: float | None, program: Surroundings) -> None:
        program.set_text(element, tag, _to_file(value, factor, True))

    return Field(key, title, "number", read, write, unit=unit, **more)


def attribute_text(key: str, title: str, attribute: str, *, empty: bool = True, **more: Any) -> Field:
    """A text that is an attribute. empty: without text the attribute stays."""

    def write(element: Element, value: str, program: Surroundings) -> None:
        program.set_attribute(element, attribute, value if value or empty else None)

    return Field(key, title, "text", lambda element, _: element.get(attribute), write, **more)


def attribute_choice(key: str, title: str, attribute: str, choices: dict[str, str], **more: Any) -> Field:
    """One of several values of an attribute. choices: value and title."""

    def write(element: Element, value: str, program: Surroundings) -> None:
        program.set_attribute(element, attribute, value)

    return Field(
        key,
        title,
        "choice",
        lambda element, _: element.get(attribute),
        write,
        choices=tuple(choices.items()),
        **more,
    )


def attribute_boolean(key: str, title: str, attribute: str, **more: Any) -> Field:
    """An attribute that is true or false."""

    def write(element: Element, value: bool, program: Surroundings) -> None:
        program.set_attribute(element, attribute, "true" if value else "false")

    return Field(key, title, "boolean", lambda element, _: element.get(attribute) == "true", write, **more)


def node_name(key: str = "name", title: str = "Name", *, what: str, free: bool = False) -> Field:
    """The name that people give a node. free: any text, as folders have it."""

    def write(element: Element, value: str, program: Surroundings) -> None:
        if not value.strip():
            raise FieldError("it needs a name")
        if not free:
            check_name(value, what)
        if not free and what != "waypoint" and value in program.names(tag_of(element)):
            raise FieldError(f"there is a {what} called {value!r} already")
        program.set_attribute(element, "name", value)

    return Field(key, title, "text", lambda element, _: element.get("name"), write)


def variable_field(key: str, title: str, tag: str = "variable", **more: Any) -> Field:
    """A variable of the program, which is made if it is new, or of the installation."""

    def read(element: Element, _: Surroundings) -> Value:
        child = element.child(tag)
        return (child.get("name") or child.get("featureName") or None) if child else None

    def write(element: Element, value: str | None, program: Surroundings) -> None:
        program.set_child(element, tag, program.variable(value, tag) if value else None)

    return Field(key, title, "variable", read, write, options=Surroundings.variables, optional=True, **more)


def pin_field(key: str, title: str, kinds: Sequence[str], **more: Any) -> Field:
    """An input or output of some kinds, by its name or as ``digital_out[0]``."""

    def read(element: Element, _: Surroundings) -> Value:
        pin = element.child("pin")
        return (pin.get("referencedName") or None) if pin else None

    def write(element: Element, value: str | None, program: Surroundings) -> None:
        if value is None:
            program.set_child(element, "pin", None)
            return
        found = find_pin(value, program.installation.pins)
        if found is None or (found[0] in PINS and int(found[1]) >= _COUNTS[found[0]]):
            raise FieldError(f"there is no input or output called {value!r}")
        if found[0] not in kinds:
            raise FieldError(f"{value} is none that can be used here; choose one of {', '.join(kinds)}")
        program.set_child(element, "pin", program.named("pin", value))

    def options(program: Surroundings) -> Sequence[str]:
        return program.pins(kinds)

    return Field(key, title, "pin", read, write, options=options, optional=True, **more)


FEATURE_TITLES: Final = {BASE: "Base", TOOL: "Tool"}


def feature_names(program: Surroundings) -> list[str]:
    """The features a program may name, as PolyScope shows them."""
    return [*FEATURE_TITLES.values(), *sorted(set(program.installation.features) - set(FEATURE_TITLES))]


def feature_field(key: str, title: str, *, declared: bool = False, **more: Any) -> Field:
    """A feature of the installation, or the base or tool."""

    def read(element: Element, _: Surroundings) -> Value:
        child = element.child("feature")
        name = (child.get("referencedName") or child.get("featureName")) if child else ""
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


# expressions

_TOKENS: Final = {"True", "False", "and", "or", "xor", "not"}  # what PolyScope's editor puts in as one piece
_SYMBOLS: Final = {"==": "≟", "!=": "≠", "<=": "≤", ">=": "≥"}


def expression_shown(element: Element | None) -> str:
    """An expression as PolyScope shows it."""
    return "" if element is None else "".join(_part_shown(part) for part in element.resolved())


def _part_shown(part: Element) -> str:
    if part.tag == "ExpressionChar":
        return part.get("character")
    if part.tag == "ExpressionToken":
        return part.get("token")
    for child in part.resolved().children:
        name = child.get("name") or child.get("featureName") or child.get("referencedName")
        return FEATURE_TITLES.get(name, name)
    return ""


def expression_of(text: str, program: Surroundings, tag: str = "expression") -> Element:
    """An expression from its text: variables, inputs, outputs and waypoints that the program has become places that
    share them, what PolyScope's editor has a key for becomes one token, all else stays letter by letter."""
    element = make(tag)
    for part in _parts(text, program):
        part.parent = element
        element.children.append(part)
    return element


def _parts(text: str, program: Surroundings) -> Iterator[Element]:
    variables = set(program.variables())
    waypoints = {place.get("name"): place for place in program.root.places() if tag_of(place) == "Waypoint"}
    pieces = _pieces(text, sorted(program.installation.pins, key=len, reverse=True))
    for index, (piece, is_pin) in enumerate(pieces):
        if is_pin:
            yield make("ExpressionIO", program.named("pin", piece))
        elif piece in variables:
            yield make("ExpressionVariable", program.variable(piece, "ProgramVariable"))
        elif piece in waypoints:
            yield make("ExpressionWaypoint", sharing("Waypoint", waypoints[piece], referenceName=piece))
        elif piece in _TOKENS:
            yield make("ExpressionToken", token=f" {piece} ")
        elif piece in _SYMBOLS:
            yield make("ExpressionChar", character=_SYMBOLS[piece])
        elif piece == " " and any(0 <= at < len(pieces) and pieces[at][0] in _TOKENS for at in (index - 1, index + 1)):
            continue  # the token has its own blanks
        else:
            for letter in piece:
                yield make("ExpressionChar", character=letter)


def _pieces(text: str, named_pins: Sequence[str]) -> list[tuple[str, bool]]:
    """Words, symbols and strings; whether it is an input or output."""
    pieces: list[tuple[str, bool]] = []
    at = 0
    while at < len(text):
        length, is_pin = _piece_length(text, at, named_pins)
        pieces.append((text[at : at + length], is_pin))
        at += length
    return pieces


def _piece_length(text: str, at: int, named_pins: Sequence[str]) -> tuple[int, bool]:
    if text[at] == '"':
        end = text.find('"', at + 1)
        return (end + 1 if end >= 0 else len(text)) - at, False
    starts_word = at == 0 or not _in_word(text[at - 1])
    if starts_word:
        for name in named_pins:
            if text.startswith(name, at) and not _in_word(text[at + len(name) : at + len(name) + 1]):
                return len(name), True
        end = at
        while end < len(text) and _in_word(text[end]):
            end += 1
        word = text[at:end]
        close = text.find("]", end)
        if word in PINS and text[end : end + 1] == "[" and text[end + 1 : close].isdecimal():
            return close + 1 - at, True
        if word:
            return len(word), False
    return (2, False) if text[at : at + 2] in _SYMBOLS else (1, False)


def _in_word(letter: str) -> bool:
    return letter.isalnum() or letter == "_"


def expression_field(key: str, title: str, tag: str = "expression", **more: Any) -> Field:
    """An expression."""

    def write(element: Element, value: str, program: Surroundings) -> None:
        program.set_child(element, tag, expression_of(value, program, tag))

    return Field(key, title, "expression", lambda element, _: expression_shown(element.child(tag)), write, **more)


def titled(title: str, text: str) -> str:
    """What a node is and says, as its line in the tree."""
    return f"{title} {text}" if text else title


def lacks_expression(element: Element, tag: str = "expression") -> bool:
    """Whether a node's expression is empty, which PolyScope shows as undefined."""
    return not expression_shown(element.child(tag)).strip()
