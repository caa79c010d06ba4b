"""Read PolyScope's installation files: tool, payload, features, names of inputs and outputs."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from urproto.robots.pose import Pose
from urproto.text import from_bytes, lines, strip
from urproto.vectors import ZERO3, Vector3
from urscript.polyscope.document import DocumentError, Element, read_document, read_steps, unpacked
from urscript.polyscope.features import read_features
from urscript.polyscope.folder import read_file
from urscript.polyscope.numbers import number, numbers, six
from urscript.polyscope.safety_configuration import SafetyConfiguration
from urscript.polyscope.safety_section import SafetySettingsError, read_safety_settings
from urscript.work import Steps, run_to_end

_AT_ONCE: Final = 64  # elements between two yields
_UNIT_WORK: Final = 4  # measured: 3 microseconds
MODBUS_TYPES: Final = {
    "DIGITAL_INPUT": 0,
    "DIGITAL_OUTPUT": 1,
    "REGISTER_INPUT": 2,
    "REGISTER_OUTPUT": 3,
}  # as for scripts
MAX_ELEMENTS: Final = 20_000
"""Most elements of an installation, which is interpreted in few steps (guess)."""

_ELEMENT_WORK: Final = 1  # measured: 0.5 to 2 microseconds
_BYTES_PER_WORK: Final = 20
_MAX_VARIABLES: Final = 1 << 20  # bytes of the installation variables, unpacked (guess)
_ROOT: Final = "Installation"
_GRAVITY: Final = 9.82  # m/s2; in every program PolyScope generates
PIN_NAMES: Final = {  # element with the names -> kind of pin
    "DigitalInputNames": "digital_in",
    "DigitalOutputNames": "digital_out",
    "ToolDigitalInputNames": "tool_in",
    "ToolDigitalOutputNames": "tool_out",
    "AnalogInputNames": "analog_in",
    "AnalogOutputNames": "analog_out",
    "ToolAnalogInputNames": "tool_analog_in",
    "ConfigurableInputNames": "config_in",
    "ConfigurableOutputNames": "config_out",
    "GeneralPurposeBooleanRegisterInputNames": "GP_bool_in",
    "GeneralPurposeBooleanRegisterOutputNames": "GP_bool_out",
    "GeneralPurposeIntRegisterInputNames": "GP_int_in",
    "GeneralPurposeIntRegisterOutputNames": "GP_int_out",
    "GeneralPurposeFloatRegisterInputNames": "GP_float_in",
    "GeneralPurposeFloatRegisterOutputNames": "GP_float_out",
}
_ESCAPED_LETTER: Final = re.compile(r"\\u([0-9A-Fa-f]{4})")
_OUTPUT_KINDS: Final = {"SINKING": 1, "SOURCING": 2, "PUSH_PULL": 3}
_PARITIES: Final = {"NONE": 0, "ODD": 1, "EVEN": 2}  # as for set_tool_communication
_VOLTAGES: Final = {"12": 12, "TWELVE": 12, "24": 24, "TWENTYFOUR": 24, "TWENTY_FOUR": 24}  # the rest is 0


@dataclass(frozen=True, slots=True)
class ModbusSignal:
    """A Modbus signal with the arguments of modbus_add_signal. frequency: [Hz], negative for the default."""

    name: str
    address: str
    slave: int
    register: int
    type: int
    frequency: int


def _modbus_steps(root: Element) -> Steps[tuple[ModbusSignal, ...]]:
    signals = list[ModbusSignal]()
    for place, unit in enumerate(root.walk()):
        if place % _AT_ONCE == 0:
            yield _AT_ONCE * _UNIT_WORK
        address = _value(unit, "ipAddress", "ip__address")
        if address and unit.tag != "ModbusSignal":
            for index, signal in enumerate(unit.walk()):
                if index % _AT_ONCE == 0:
                    yield _AT_ONCE
                if signal.tag.rpartition(".")[2] == "ModbusSignal":
                    signals.append(_signal(signal, address))
    return tuple(signals)


def _signal(signal: Element, address: str) -> ModbusSignal:
    kind = _value(signal, "type")
    return ModbusSignal(
        name=_value(signal, "name"),
        address=address,
        slave=int(number(_value(signal, "slaveAddress") or "255")),
        register=int(number(_value(signal, "signalAddress") or "0")),
        type=MODBUS_TYPES[kind] if kind in MODBUS_TYPES else int(number(kind or "0")),
        frequency=int(number(_value(signal, "updateFrequency") or "-1")),
    )


def _value(element: Element, *names: str) -> str:
    for name in names:
        child = element.child(name)
        if element.get(name):
            return element.get(name)
        if child is not None and child.text.strip():
            return child.text.strip()
    return ""


@dataclass(frozen=True, slots=True)
class PayloadSetting:
    """Mass [kg], centre of gravity from the flange [m], and inertia [kg m2] if the file contains it."""

    mass: float = 0.0
    cog: Vector3 = ZERO3
    inertia: Pose | None = None


@dataclass(frozen=True, slots=True)
class InputTrigger:
    """An input, by PolyScope's name or the user's, and the level that triggers the action."""

    pin: str
    level: bool


@dataclass(frozen=True, slots=True)
class DefaultProgram:
    """Actions of the controller without an operator. name: path in the programs folder. load: load it at boot.

    release_brakes, start: the inputs that switch on the arm and play the program; None for none.
    """

    name: str = ""
    load: bool = False
    release_brakes: InputTrigger | None = None
    start: InputTrigger | None = None


@dataclass(frozen=True, slots=True)
class InstallationFile:
    """The settings of an installation that programs need. Without a file, programs do not change tool and mounting.

    tcps, payloads, features: by name; ``tcp`` and ``payload`` are those active at the start.
    feature_variables: features that programs may use as variables. pins: a kind of `urscript.polyscope.writer` and a
    number for each name. actions: the automatic action of a pin such as digital_in[0], in PolyScope's words; pins
    without one are omitted. variables: name and URScript value.
    tool_*: as for set_tool_voltage, set_tool_communication, set_tool_output_mode, set_tool_digital_output_mode.
    gravity: as for set_gravity [m/s2]. home: joints [rad]. contributions: data of URCaps by URCap name.
    safety: the safety configuration in the file; None if there is no readable one. default_program: what the controller
    does without an operator.
    """

    name: str = "default"
    tcp: Pose | None = None
    tcps: Mapping[str, Pose] = field(default_factory=dict)
    payload: PayloadSetting | None = None
    payloads: Mapping[str, PayloadSetting] = field(default_factory=dict)
    gravity: Vector3 | None = None
    features: Mapping[str, Pose] = field(default_factory=dict)
    feature_variables: frozenset[str] = frozenset()
    pins: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    actions: Mapping[str, str] = field(default_factory=dict)
    modbus: tuple[ModbusSignal, ...] = ()
    variables: Mapping[str, str] = field(default_factory=dict)
    home: Pose | None = None
    analog_inputs: tuple[int, ...] = (1, 1)
    tool_inputs: tuple[int, ...] = (1, 1)
    analog_outputs: tuple[int, ...] = (0, 0)
    tool_voltage: int = 0
    tool_serial: tuple[bool, int, int, int, float, float] = (False, 115200, 0, 1, 1.5, 3.5)
    tool_output_mode: int = 0
    tool_outputs: tuple[int, ...] = (1, 1)
    contributions: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    safety: SafetyConfiguration | None = None
    default_program: DefaultProgram = field(default_factory=DefaultProgram)


def read_installation_steps(path: Path) -> Steps[InstallationFile]:
    """Read an ``.installation`` file and the ``.variables`` next to it, in pieces for a control loop.

    Raises OSError or DocumentError.
    """
    beside = path.with_suffix(".variables")
    data = read_file(path)
    variables = read_file(beside) if beside.is_file() else b""
    root = yield from read_steps(data, MAX_ELEMENTS)
    return (yield from _installation(root, path.stem, variables))


def read_installation(data: bytes, name: str, variables: bytes = b"") -> InstallationFile:
    """Parse the contents of an ``.installation`` and of its ``.variables``. Raises DocumentError."""
    return run_to_end(_installation(read_document(data, MAX_ELEMENTS), name, variables))


def read_installation_document(root: Element, name: str, variables: bytes = b"") -> InstallationFile:
    """Interpret the document of an ``.installation``, and its ``.variables``. Raises DocumentError."""
    return run_to_end(_installation(root, name, variables))


def load_installation_file(path: Path) -> InstallationFile:
    """Like `read_installation_steps`, in one go."""
    return run_to_end(read_installation_steps(path))


def _installation(root: Element, name: str, variables: bytes) -> Steps[InstallationFile]:
    """Interpret a document; between two yields, its elements are walked through once."""
    work = _ELEMENT_WORK * sum(1 for _ in root.walk())
    if root.tag != _ROOT:
        raise DocumentError(f"<{root.tag}> is not an installation")
    tcps, tcp = _tcps(root)
    payloads, payload = _payloads(root)
    yield work
    features, feature_variables = read_features(root)
    yield work
    modbus = yield from _modbus_steps(root)
    gravity = _gravity(root)
    yield work
    contributions = _contributions(root)
    yield work
    stored_variables = read_variables(variables)
    yield len(variables) // _BYTES_PER_WORK
    domains = _ints(root, "analogInputRange", (1, 1, 1, 1))
    return InstallationFile(
        name=name,
        tcp=tcp,
        tcps=tcps,
        payload=payload,
        payloads=payloads,
        gravity=gravity,
        features=features,
        feature_variables=feature_variables,
        pins={**_pins(root), **{signal.name: ("modbus", signal.name) for signal in modbus}},
        actions=dict(_actions(root)),
        modbus=modbus,
        variables=stored_variables,
        home=_home(root),
        analog_inputs=domains[:2],
        tool_inputs=domains[2:],
        analog_outputs=_ints(root, "analogOutputDomain", (0, 0)),
        tool_voltage=_tool_voltage(root),
        tool_serial=_tool_serial(root),
        tool_output_mode=0 if _tool(root, "toolOutputMode") in ("", "OUTPUT") else 1,
        tool_outputs=tuple(_OUTPUT_KINDS.get(_tool(root, f"toolDigitalOutput{port}"), 1) for port in (0, 1)),
        contributions=contributions,
        safety=_safety(root),
        default_program=_default_program(root),
    )


def _default_program(root: Element) -> DefaultProgram:
    settings = root.child("DefaultProgramSettings")
    if settings is None:
        return DefaultProgram()

    def trigger(pin: str, level: str) -> InputTrigger | None:
        return InputTrigger(settings.get(pin), settings.get(level) == "true") if settings.get(pin) else None

    return DefaultProgram(
        name=settings.get("fileName"),
        load=settings.get("autoLoad") == "true",
        release_brakes=trigger("nameOfSensorToInitialize", "triggerValueToInitialize"),
        start=trigger("nameOfSensorToAutoStartProgram", "triggerValueToStartProgram"),
    )


def _safety(root: Element) -> SafetyConfiguration | None:
    settings = root.child("SafetySettings")
    try:
        return None if settings is None else read_safety_settings(settings.text)
    except SafetySettingsError:
        return None


def read_variables(data: bytes) -> dict[str, str]:
    """Installation variables and their URScript values; compressed or not.

    The file is XML since about PolyScope 5.10, and a Java properties file with one line per variable before. Other
    lines are skipped. Raises DocumentError.
    """
    text = unpacked(data, _MAX_VARIABLES)
    if text.lstrip().startswith(b"<"):
        variables = (element for element in read_document(text).walk() if element.tag == "variable")
        return {element.get("name"): element.get("value") for element in variables if element.get("value")}
    entries = (strip(line).partition("=") for line in lines(from_bytes(text)))
    return {
        strip(name): _unescaped(value) for name, equals, value in entries if equals and not name.startswith(("#", "!"))
    }


def _unescaped(value: str) -> str:
    """Undo Java's escapes: a backslash before separators, and numbers for characters outside ASCII."""
    numbers_read = _ESCAPED_LETTER.sub(lambda match: chr(int(match[1], 16)), strip(value))
    return re.sub(r"\\(.)", r"\1", numbers_read)


def tcp_settings(root: Element) -> Element:
    """The element with the TCPs, whose name differs between versions. Raises DocumentError without one."""
    settings = next((element for element in root if "activePose" in element.attributes), None)
    if settings is None:
        raise DocumentError("the installation names no active TCP")
    return settings


def _tcps(root: Element) -> tuple[dict[str, Pose], Pose]:
    settings = tcp_settings(root)
    tcps = {e.get("name"): six(e.get("offset")) for e in settings.walk() if e.tag == "tcp" and e.get("offset")}
    active = settings.get("activePose")
    if active not in tcps:
        raise DocumentError(f"the active TCP {active!r} is not among the TCPs of the installation")
    return tcps, tcps[active]


def _payloads(root: Element) -> tuple[dict[str, PayloadSetting], PayloadSetting]:
    settings = root.child("PayloadSettings")
    if settings is None:
        old = tcp_settings(root)
        cog = numbers(old.get("centerOfGravity", "0, 0, 0"))
        return {}, PayloadSetting(number(old.get("toolPayload", "0")), _three(cog))
    payloads, default = {}, PayloadSetting()
    for element in settings:
        inertia = six(element.get("inertiaParameters", "0, 0, 0, 0, 0, 0"))
        payload = PayloadSetting(
            number(element.get("mass", "0")), _three(numbers(element.get("centerOfGravity", "0, 0, 0"))), inertia
        )
        payloads[element.get("name")] = payload
        if element.get("defaultPayload") == "true":
            default = payload
    return payloads, default


def _three(values: list[float]) -> Vector3:
    if len(values) != 3:
        raise DocumentError(f"expected three numbers, not {values}")
    return (values[0], values[1], values[2])


def gravity_of(tilt_rad: float, turn_rad: float) -> Vector3:
    """Gravity in the base frame [m/s2] for a base tilted about x, then turned about z, as on PolyScope's mounting page;
    signs as in public scripts."""
    across, along = _GRAVITY * math.sin(tilt_rad), _GRAVITY * math.cos(tilt_rad)
    return (across * math.sin(turn_rad) + 0.0, -across * math.cos(turn_rad) + 0.0, along + 0.0)


def _gravity(root: Element) -> Vector3:
    for element in root.walk():
        if "tiltAngle" in element.attributes:
            return gravity_of(number(element.get("tiltAngle")), number(element.get("baseAngle", "0")))
    return gravity_of(0.0, 0.0)


def _pins(root: Element) -> dict[str, tuple[str, str]]:
    pins = {}
    for element in root.child("IOs") or ():
        kind = PIN_NAMES.get(element.tag)
        for index, name in enumerate(element.get("value").split(",") if kind else ()):
            if kind and name.strip():
                pins[name.strip()] = (kind, str(index))
    return pins


def _actions(root: Element) -> Iterator[tuple[str, str]]:
    ios = root.child("IOs")
    for tag, kind in PIN_NAMES.items():
        element = ios.child(tag.removesuffix("Names") + "Actions") if ios else None
        for index, action in enumerate(element.get("value").split(",") if element else ()):
            if action.strip() not in ("", "NONE"):
                yield f"{kind}[{index}]", action.strip()


def _home(root: Element) -> Pose | None:
    settings = root.child("SafeHomeSettings")
    return six(settings.get("position")) if settings and settings.get("position") else None


def _ints(root: Element, tag: str, default: tuple[int, ...]) -> tuple[int, ...]:
    element = next((e for e in root.child("IOs") or () if e.tag == tag), None)
    values = tuple(int(value) for value in numbers(element.get("value"))) if element else default
    return values if len(values) == len(default) else default


def _tool(root: Element, name: str) -> str:
    settings = root.child("ToolCommSettings")
    return settings.get(name) if settings else ""


def _tool_voltage(root: Element) -> int:
    text = _tool(root, "toolOutputVoltage") or root.get("toolOutputVoltage")
    return _VOLTAGES.get(text, 0)


def _tool_serial(root: Element) -> tuple[bool, int, int, int, float, float]:
    baud = _tool(root, "baudRate").removeprefix("BAUD_")
    return (
        _tool(root, "enabled") == "true",
        int(baud) if re.fullmatch("[0-9]{1,9}", baud) else 115200,
        _PARITIES.get(_tool(root, "parity"), 0),
        2 if _tool(root, "stopBits") == "TWO" else 1,
        number(_tool(root, "rxIdleChars") or "1.5"),
        number(_tool(root, "txIdleChars") or "3.5"),
    )


def _contributions(root: Element) -> dict[str, dict[str, str]]:
    return {e.get("name"): dict(_data(e)) for e in root.walk() if e.tag == "Contributed"}


def _data(element: Element) -> Iterator[tuple[str, str]]:
    for data in element:
        if data.get("key"):
            yield data.get("key"), data.get("value")
