"""The writer that collects the URScript of a program tree."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

from urproto.versions import PolyscopeVersion, Series
from urscript.polyscope.document import DocumentError, Element
from urscript.polyscope.features import BASE_VARIABLE
from urscript.polyscope.installation_file import InstallationFile, PayloadSetting
from urscript.polyscope.numbers import identifier, list_text, pose_text, quoted, taught_pose
from urscript.polyscope.starting import StartingNode
from urscript.polyscope.tree import ProgramTree, TreeError
from urscript.work import Steps, run_to_end

_NUMBERED: Final = re.compile(r"(\w+)\[([0-9]{1,9})\]")

# name without the number -> reading and writing call, as PolyScope writes them
PINS: Final[dict[str, tuple[str, str]]] = {
    "digital_in": ("get_standard_digital_in({0})", ""),
    "digital_out": ("get_standard_digital_out({0})", "set_standard_digital_out({0}, {1})"),
    "config_in": ("get_configurable_digital_in({0})", ""),
    "config_out": ("get_configurable_digital_out({0})", "set_configurable_digital_out({0}, {1})"),
    "tool_in": ("get_tool_digital_in({0})", ""),
    "tool_out": ("get_tool_digital_out({0})", "set_tool_digital_out({0}, {1})"),
    "analog_in": ("get_standard_analog_in({0})", ""),
    "analog_out": ("get_standard_analog_out({0})", "set_standard_analog_out({0}, {1})"),
    "tool_analog_in": ("get_tool_analog_in({0})", ""),
    "GP_bool_in": ("read_input_boolean_register({0})", ""),
    "GP_bool_out": ("read_output_boolean_register({0})", "write_output_boolean_register({0}, {1})"),
    "GP_int_in": ("read_input_integer_register({0})", ""),
    "GP_int_out": ("read_output_integer_register({0})", "write_output_integer_register({0}, {1})"),
    "GP_float_in": ("read_input_float_register({0})", ""),
    "GP_float_out": ("read_output_float_register({0})", "write_output_float_register({0}, {1})"),
}
# symbol in the editor -> operator of the language; the four that occur in files
_SYMBOLS: Final = {"≟": " == ", "≠": " != ", "≤": " <= ", "≥": " >= "}
_SYMBOL: Final = re.compile("|".join(_SYMBOLS))
_STRING: Final = re.compile(r'("[^"]*")')
_VARIABLES: Final = ("ProgramVariable", "InstallationVariable", "GeomFeatureVariable")
_MAX_DEPTH: Final = 60  # as many blocks as a script may nest
_LINES_PER_WORK: Final = 10  # measured: 0.1 microseconds for a line
_MAX_SIZE: Final = 8 << 20  # bytes of script; the largest public one has 1.4 MB
_PAYLOAD_WITH_INERTIA: Final = (5, 10)  # first version whose programs say set_target_payload
BASE: Final = "Joint_0_name"  # PolyScope's names of the features every installation has
TOOL: Final = "Joint_6_name"
NO_POSE: Final = "p[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]"
SECTIONS: Final = ("preamble", "urcaps", "variables", "waypoints", "timers", "subprograms", "before", "threads", "main")


def pin_name(pin: Element | None) -> str:
    """The name of a node's pin. Raises DocumentError without one."""
    name = "" if pin is None else pin.get("referencedName")
    if not name:
        raise DocumentError("a node does not name its input or output")
    return name


def find_pin(name: str, names: Mapping[str, tuple[str, str]]) -> tuple[str, str] | None:
    """Kind (a key of PINS, or modbus) and number (or signal name) of a pin. names: those in the installation."""
    match = _NUMBERED.fullmatch(name)
    return (match[1], match[2]) if match and match[1] in PINS else names.get(name)


def resolve_pin(writer: "Writer", pin: Element | None) -> tuple[str, str]:
    """Kind (a key of PINS, or modbus) and number (or signal name) of a pin.

    Raises DocumentError for a name that is neither PolyScope's nor in the installation.
    """
    name = pin_name(pin)
    found = find_pin(name, writer.installation.pins)
    if found is None:
        raise DocumentError(f"the installation {writer.installation.name} has no input or output called {name}")
    return found


def pin_reading(writer: "Writer", pin: Element | None) -> str:
    """URScript that reads an input, or the current state of an output."""
    kind, number = resolve_pin(writer, pin)
    if kind == "modbus":
        return f"modbus_get_signal_status({quoted(number)})"
    return PINS[kind][0].format(number)


def pin_writing(writer: "Writer", pin: Element | None, value: str) -> str:
    """URScript that sets an output. Raises DocumentError for an input."""
    kind, number = resolve_pin(writer, pin)
    if kind == "modbus":
        call = "modbus_set_output_signal" if value in ("True", "False") else "modbus_set_output_register"
        return f"{call}({quoted(number)}, {value})"
    if not PINS[kind][1]:
        raise DocumentError(f"{pin_name(pin)} is an input and cannot be set")
    return PINS[kind][1].format(number, value)


def expression_text(writer: "Writer", element: Element | None) -> str:
    """URScript of an expression. Raises DocumentError for an unknown part."""
    if element is None:
        return ""
    text = "".join(_part(writer, part) for part in element.resolved())
    pieces = _STRING.split(text)
    return "".join(piece if index % 2 else _in_script(piece) for index, piece in enumerate(pieces)).strip()


def expression_label(writer: "Writer", element: Element | None) -> str:
    """An expression as shown in the program tree."""
    return "" if element is None else "".join(_part(writer, part) for part in element.resolved())


def variable_name(element: Element | None) -> str:
    """Name in scripts of a variable, or of a feature used as one. Raises DocumentError when there is none."""
    name = "" if element is None else element.get("name") or element.get("featureName")
    if not name:
        raise DocumentError("a variable has no name")
    return identifier(name)


def _in_script(text: str) -> str:
    return _SYMBOL.sub(lambda match: _SYMBOLS[match[0]], text)


def _part(writer: "Writer", part: Element) -> str:
    if part.tag == "ExpressionChar":
        return part.get("character")
    if part.tag == "ExpressionToken":
        return part.get("token")
    if part.tag == "ExpressionVariable":
        return variable_name(part.child(*_VARIABLES))
    if part.tag == "ExpressionIO" and (pin := part.child("pin")):
        return pin_reading(writer, pin)
    if part.tag == "ExpressionWaypoint" and (waypoint := part.child("Waypoint")):
        return writer.waypoint(waypoint)[0]
    if part.tag == "ExpressionGeomFeature":
        return writer.feature(part.child("feature"), variable=True)
    raise DocumentError(f"an expression contains an unknown <{part.tag}>")


@dataclass(frozen=True, slots=True)
class ExternalControlCode:
    """The code provided by a driver. header: written once per program; node: at each External Control node."""

    header: str
    node: str


class Writer:
    """Collects the lines of a program by section, in the order PolyScope writes the sections.

    labels: the texts of the nodes by their line in the program tree. timers: variables that count seconds.
    starting: the node at which the program begins, None for all of it.
    problems: if this is a list, problems of nodes are added to it instead of raising an error.
    """

    def __init__(
        self,
        tree: ProgramTree,
        installation: InstallationFile,
        version: PolyscopeVersion,
        external_control: ExternalControlCode | None,
        problems: list[tuple[Element, str]] | None = None,
        starting: StartingNode | None = None,
    ) -> None:
        self.problems = problems
        self.tree = tree
        self.starting = starting
        self.version = version
        self.installation = installation
        self.external_control = external_control
        self._sections: dict[str, list[str]] = {name: [] for name in SECTIONS}
        self._authors: dict[str, list[Element | None]] = {name: [] for name in SECTIONS}
        self._levels: dict[str, int] = dict.fromkeys(SECTIONS, 1)
        self._section = "main"
        self.labels: dict[int, str] = {}
        self.timers: list[str] = []
        self._trees = [tree]
        self._numbers = dict(tree.numbers)
        self._counters: dict[str, int] = {}
        self._once: set[str] = set()
        self._nodes: list[Element] = []
        self._size = 0
        self._waypoints: dict[str, tuple[str, str]] = {}

    @contextmanager
    def node(self, element: Element) -> Iterator[None]:
        """Context in which a node is written. Raises TreeError for too deep nesting: references can be cyclic."""
        if len(self._nodes) >= _MAX_DEPTH:
            raise TreeError(f"nodes are nested more than {_MAX_DEPTH} deep at <{element.tag}>")
        self._nodes.append(element)
        yield
        self._nodes.pop()

    def _write(self, line: str) -> None:
        self._size += len(line) + 1
        if self._size > _MAX_SIZE:
            raise TreeError(f"the program has more than {_MAX_SIZE >> 20} MiB of script")
        self._sections[self._section].append(line)
        self._authors[self._section].append(self._nodes[-1] if self._nodes else None)

    def line(self, text: str) -> None:
        """Write one line with indentation; further lines of a text are written unchanged."""
        self._write(f"{'  ' * self._levels[self._section]}{text}")

    def raw(self, lines: Iterable[str]) -> None:
        """Write lines unchanged."""
        for line in lines:
            self._write(line)

    def label(self, element: Element, text: str, stop: str = "") -> None:
        """Write the label from which a client sees the position in the program. stop: breakAfter or noBreak."""
        number = self.number(element)
        self.labels.setdefault(number, text)
        self.line(f"$ {number} {quoted(text)}" + (f' "{stop}"' if stop else ""))

    @contextmanager
    def block(self, head: str) -> Iterator[None]:
        """Context that writes a block with its ``end``."""
        self.line(head)
        with self.indented():
            yield
        self.line("end")

    @contextmanager
    def indented(self) -> Iterator[None]:
        """Context in which lines are indented."""
        section = self._section
        self._levels[section] += 1
        try:
            yield
        finally:
            self._levels[section] -= 1

    @contextmanager
    def into(self, section: str) -> Iterator[None]:
        """Context in which lines go to another section."""
        before, self._section = self._section, section
        try:
            yield
        finally:
            self._section = before

    def count(self, kind: str) -> int:
        """A counter for each kind: 1, 2, 3, ..."""
        self._counters[kind] = self._counters.get(kind, 0) + 1
        return self._counters[kind]

    def once(self, key: str) -> bool:
        """True the first time it is called with a key."""
        if key in self._once:
            return False
        self._once.add(key)
        return True

    def number(self, element: Element) -> int:
        """Line of a node in the program tree."""
        return self._numbers.get(id(element.resolved()), 0)

    def adopt(self, tree: ProgramTree) -> None:
        """Add a program file that is called; its line numbers continue after those before."""
        last = max(self._numbers.values(), default=0)
        self._numbers.update({key: last + number for key, number in tree.numbers.items()})
        self._trees.append(tree)

    def home(self, element: Element) -> ProgramTree:
        """The program file that contains a node."""
        return next((tree for tree in self._trees if id(element.resolved()) in tree.numbers), self.tree)

    @staticmethod
    def line_in(tree: ProgramTree, element: Element) -> int:
        """Line of a node in its program file."""
        return tree.numbers[id(element.resolved())]

    # objects that nodes refer to

    def waypoint(self, element: Element) -> tuple[str, str]:
        """Names of the variables with the pose and joints of a taught waypoint, which are written at the first use."""
        name = identifier(element.get("name") or "Waypoint")  # waypoints of the same name are the same
        if name not in self._waypoints:
            self._write_waypoint(element, name)
            self._waypoints[name] = (f"{name}_p", f"{name}_q")
        return self._waypoints[name]

    def _write_waypoint(self, element: Element, name: str) -> None:
        position = element.child("position")
        if position is None:
            raise DocumentError(f"the waypoint {element.get('name')} was never taught")
        joints, pose = taught_pose(position)
        with self.into("waypoints"):
            self.line(f"global {name}_p={pose_text(pose)}")
            self.line(f"global {name}_q={list_text(joints)}")

    def feature(self, reference: Element | None, *, variable: bool = False) -> str:
        """URScript of a feature's pose in the base frame. Raises DocumentError if the installation lacks the feature.

        variable: prefer the name of the variable with the pose, if there is one.
        """
        name = "" if reference is None else reference.get("referencedName") or reference.get("featureName")
        if variable and name == BASE and BASE_VARIABLE in self.installation.feature_variables:
            return BASE_VARIABLE
        if name in ("", BASE):
            return NO_POSE
        if name == TOOL:
            return "get_forward_kin()"
        if name not in self.installation.features:
            raise DocumentError(f"the installation {self.installation.name} has no feature called {name}")
        if variable and name in self.installation.feature_variables:
            return identifier(name)
        return pose_text(self.installation.features[name])

    def condition(self, part: Element, chain: Sequence[Element] = ()) -> str:
        """URScript of the expression of a branch or loop. chain: all branches of the If."""
        text = expression_text(self, part.child("expression"))
        return text if self.starting is None else self.starting.condition(part, chain, text)

    def payload(self, setting: PayloadSetting) -> str:
        """URScript that sets a payload of the installation."""
        mass, cog = setting.mass, list_text(setting.cog)
        version = self.version
        modern = version.series is Series.E and (version.major, version.minor) >= _PAYLOAD_WITH_INERTIA
        if modern and setting.inertia is not None:
            return f"set_target_payload({mass}, {cog}, {list_text(setting.inertia)})"
        return f"set_payload({mass}, {cog})"

    def tcp(self, reference: Element | None) -> str:
        """URScript of a TCP offset. Raises DocumentError if the installation lacks the TCP."""
        name = "" if reference is None else reference.get("referencedName")
        if name not in self.installation.tcps:
            raise DocumentError(f"the installation {self.installation.name} has no TCP called {name!r}")
        return pose_text(self.installation.tcps[name])

    def write_timers(self) -> None:
        """Write the one thread that counts for all timers, as in PolyScope."""
        if not self.timers:
            return
        with self.into("timers"):
            for name in self.timers:
                self.line(f"global {name}=0")
                self.line(f"global {name}_is_counting=False")
            with self.block("thread Timer_Thread():"), self.block("while (True):"):
                for name in reversed(self.timers):  # PolyScope's order
                    with self.block(f"if ({name}_is_counting):"):
                        self.line(f"{name} = {name} + get_steptime()")
                self.line("sync()")
            self.line("run Timer_Thread()")

    def text(self) -> str:
        """The complete program."""
        return run_to_end(self.text_steps())

    def lines(self) -> list[tuple[str, Element | None]]:
        """The lines of the complete program, each with the node that wrote it."""
        return run_to_end(self.line_steps())

    def text_steps(self) -> Steps[str]:
        """Like `text`, in pieces for a control loop."""
        lines = yield from self.line_steps()
        yield len(lines) // _LINES_PER_WORK
        return "\n".join([*(line for line, _ in lines), ""])

    def line_steps(self) -> Steps[list[tuple[str, Element | None]]]:
        """Like `lines`, in pieces for a control loop."""
        program = [
            written for name in SECTIONS[1:] for written in zip(self._sections[name], self._authors[name], strict=True)
        ]
        yield len(program) // _LINES_PER_WORK
        used = yield from self.tree.saved_script.used_by([line for line, _ in program])
        lines: list[tuple[str, Element | None]] = [(f"def {identifier(self.tree.name)}():", None)]
        lines += [(line, None) for line in self._sections[SECTIONS[0]]]
        lines += [(line, None) for line in used]
        return [*lines, *program, ("end", None)]
