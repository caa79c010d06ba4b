"""The names that nodes of a program may use: its variables and waypoints, and those of its installation."""

from collections.abc import Sequence
from typing import Final

from urproto.robots import RobotModel
from urproto.versions import PolyscopeVersion, Series
from urscript.polyscope.document import Changes, Element, make, sharing
from urscript.polyscope.folder import ProgramsFolder
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.tree import tag_of
from urscript.polyscope.writer import BASE, TOOL

_FAVOURITES: Final = PolyscopeVersion(5, 13)  # first version whose variables have a favourite flag (seen)
_FEATURE_REFERENCE: Final = "GeomFeatureReference"
VARIABLE_TAGS: Final = ("variable", "ProgramVariable", "InstallationVariable", "loopVariable")


FEATURE_TITLES: Final = {BASE: "Base", TOOL: "Tool"}


ORDERS: Final[dict[str, tuple[Sequence[str], Sequence[str]]]] = {}
"""The order of attributes and children in files, by the tag of the node; filled by the registry."""

PIN_COUNTS: Final = {  # how many of each kind there are
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


class FieldError(ValueError):
    """A value is invalid for a field; the message says which values are valid."""


class Surroundings:
    """The names that nodes of a program may use, and the information needed to create a node.

    version: of the PolyScope that the program is for. model: the arm, whose dimensions are stored with taught
    positions. folder: contains the files that nodes name.
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
        """Whether the program is for the CB3 series."""
        return self.version.series is Series.CB3

    # writing

    def set_attribute(self, element: Element, name: str, value: str | None) -> None:
        """Set an attribute of a node, in PolyScope's order."""
        self.changes.set_attribute(element, name, value, _orders(element)[0])

    def set_child(self, element: Element, tag: str, child: Element | None) -> None:
        """Set a child of a node, in PolyScope's order."""
        self.changes.set_child(element, tag, child, _orders(element)[1])

    def set_text(self, element: Element, tag: str, text: str | None) -> None:
        """Set the text of a child of a node, in PolyScope's order."""
        self.changes.set_text(element, tag, text, _orders(element)[1])

    # what the program has

    def variable_objects(self) -> dict[str, Element]:
        """The variables of the program by name, including those of the installation."""
        found: dict[str, Element] = {}
        for place in self.root.places():
            element = place.resolved()
            if place.tag in VARIABLE_TAGS and "name" in element.attributes and element.child("expression") is None:
                found.setdefault(element.attributes["name"], element)
        return found

    def variables(self) -> list[str]:
        """Names of the variables of the program and the installation."""
        return sorted({*self.variable_objects(), *self.installation.variables, *self.installation.feature_variables})

    def names(self, tag: str) -> list[str]:
        """Names of the nodes of a kind, in the order of the document."""
        found = (place.get("name") for place in self.root.places() if tag_of(place) == tag)
        return list(dict.fromkeys(name for name in found if name))

    def unused(self, stem: str, taken: Sequence[str]) -> str:
        """``stem`` followed by the first number that makes it a new name."""
        used, index = set(taken), 1
        while f"{stem}_{index}" in used:
            index += 1
        return f"{stem}_{index}"

    # what nodes name

    def variable(self, name: str, tag: str = "variable", *, new: bool = True) -> Element:
        """A place that refers to the variable with this name. Raises FieldError for an invalid or unknown name."""
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
        """A place that refers to the pin, TCP or feature with this name, which all places of the program share."""
        for place in self.root.places():
            if place.tag == tag and place.get("referencedName") == name:
                return sharing(tag, place, **attributes)
        return make(tag, **attributes, referencedName=name)

    def feature(self, name: str, tag: str = "feature", *, declared: bool = False) -> Element:
        """A place that refers to a feature. declared: the place can only hold features, so the file omits the class."""
        return self.named(tag, name, **({} if declared else {"class_": _FEATURE_REFERENCE}))

    def pins(self, kinds: Sequence[str]) -> list[str]:
        """Names in the installation of the inputs or outputs of these kinds (keys of `PINS`, or modbus)."""
        given = {pin: name for name, pin in self.installation.pins.items()}
        numbered = [(kind, str(index)) for kind in kinds for index in range(PIN_COUNTS.get(kind, 0))]
        names = [given.get(pin, f"{pin[0]}[{pin[1]}]") for pin in numbered]
        return names + [
            name for name, (kind, _) in self.installation.pins.items() if kind == "modbus" and kind in kinds
        ]


def _orders(element: Element) -> tuple[Sequence[str], Sequence[str]]:
    return ORDERS.get(tag_of(element), ((), ()))


def check_name(name: str, what: str) -> None:
    """Raise FieldError for a name that PolyScope's keyboard does not accept."""
    if not name or not (name[0].isalpha() or name[0] == "_") or not all(c.isalnum() or c == "_" for c in name):
        raise FieldError(
            f"{name!r} is not a name for a {what}: use letters, digits and underscores, not beginning with a digit"
        )
