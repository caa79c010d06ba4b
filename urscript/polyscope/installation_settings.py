"""The settings of an installation file that can be changed. One table drives reading, checks, writing, display and
documentation.

A section is a page in PolyScope: a list of rows identified by their names, or a single row. Values have the units of
URScript (m, rad, kg); ``UNITS`` maps them to those shown to users. A change writes only the attributes it concerns, in
place, so that everything else stays as PolyScope saved it. Names and places in the file are as in public files of
PolyScope 3.5 to 5.24; settings that these leave unclear are refused.
"""

import re
import uuid
from collections.abc import Iterator, Mapping
from importlib.resources import files
from typing import Any, Final

from urproto.versions import Availability, PolyscopeVersion
from urscript.polyscope.document import DocumentError, Element, link, read_document
from urscript.polyscope.installation_file import MODBUS_TYPES, PIN_NAMES, tcp_settings
from urscript.polyscope.installation_sections import (
    Features,
    Field,
    Mounting,
    Payloads,
    Row,
    Section,
    SettingError,
    Tcps,
    new_element,
)
from urscript.polyscope.safety_settings import SAFETY_SECTIONS
from urscript.polyscope.tree import EXTERNAL_CONTROL
from urscript.polyscope.writer import find_pin

_INPUT_ACTIONS: Final = ("NONE", "FREEDRIVE")  # PolyScope has more, which cannot be set here
_OUTPUT_ACTIONS: Final = ("NONE", "LOW_WHEN_PROGRAM_STOPPED")
_PIN_COUNTS: Final = {  # since PolyScope 3.13 and 5.9
    "digital_in": 8, "digital_out": 8, "tool_in": 2, "tool_out": 2, "tool_analog_in": 2, "analog_in": 2,
    "analog_out": 2, "config_in": 8, "config_out": 8, "GP_bool_in": 128, "GP_bool_out": 128, "GP_int_in": 48,
    "GP_int_out": 48, "GP_float_in": 48, "GP_float_out": 48,
}  # fmt: skip
_RATES: Final = ("0", "1", "2", "5", "10", "20", "50", "125")  # Hz
_WITHOUT_ACTIONS: Final = ("tool_analog_in", "analog_in", "GP_int_in", "GP_float_in")
_SEVERAL_PAYLOADS: Final = Availability.since(None, "5.10")


class Pins(Section):
    """Inputs and outputs: their names and automatic actions."""

    name, title = "io", "I/O"
    fields = (
        Field("pin", "Signal", fixed=True),
        Field("name", "Name"),
        Field("action", "Action"),
    )
    listed = True
    applied = "with the next program. START, STOP and PAUSE, which PolyScope executes, are kept but not offered"
    places = "`IOs`: `DigitalInputNames` and so on, lists between commas, and `DigitalInputActions` and so on"

    def rows(self, root: Element) -> list[Row]:
        rows = []
        ios = root.child("IOs")
        for element in ios or ():
            kind = PIN_NAMES.get(element.tag)
            if kind is None:
                continue
            actions = self._actions(root, element.tag)
            for index, name in enumerate(element.get("value").split(",")):
                action = actions[index].strip() if index < len(actions) else ""
                rows.append({"pin": f"{kind}[{index}]", "name": name.strip(), "action": action})
        return rows

    def write(self, root: Element, row: Row, changes: Row) -> None:
        kind, index = row["pin"][:-1].split("[")
        tag = next(tag for tag, known in PIN_NAMES.items() if known == kind)
        if "name" in changes:
            self._rename(root, tag, int(index), row, changes["name"])
        if "action" in changes:
            allowed = self.actions_of(row)
            if changes["action"] not in allowed:
                raise SettingError(
                    f"{row['pin']} cannot have the action {changes['action']!r}: "
                    + (f"it can have {', '.join(allowed)}" if allowed else "this file has no actions for it")
                )
            self._replace(root, tag.removesuffix("Names") + "Actions", int(index), changes["action"])

    @staticmethod
    def actions_of(row: Row) -> tuple[str, ...]:
        """The actions that the pin of a row may have, including its current one."""
        kind = row["pin"].partition("[")[0]
        if not row["action"]:
            return ()
        if kind in ("digital_in", "config_in", "tool_in", "GP_bool_in"):
            return tuple(dict.fromkeys((*_INPUT_ACTIONS, row["action"])))
        if kind in ("digital_out", "config_out", "tool_out", "GP_bool_out", "analog_out"):
            return tuple(dict.fromkeys((*_OUTPUT_ACTIONS, row["action"])))
        return (row["action"],)

    def _rename(self, root: Element, tag: str, index: int, row: Row, name: str) -> None:
        if "," in name:
            raise SettingError(f"{name!r} is not a valid signal name: commas separate the names in the file")
        same = next((r["pin"] for r in self.rows(root) if name and r["name"] == name and r["pin"] != row["pin"]), None)
        if same:
            raise SettingError(f"{same} is already called {name!r}")
        if re.fullmatch(r"\w+\[\d+\]", name):
            raise SettingError(f"{name!r} is the default name of a signal and cannot be given to another one")
        self._replace(root, tag, index, name)

    def _actions(self, root: Element, tag: str) -> list[str]:
        ios = root.child("IOs")
        actions = ios.child(tag.removesuffix("Names") + "Actions") if ios else None
        return actions.get("value").split(",") if actions else []

    def _replace(self, root: Element, tag: str, index: int, text: str) -> None:
        ios = root.child("IOs")
        element = ios.child(tag) if ios else None
        assert element is not None
        parts = element.get("value").split(",")
        parts[index] = f" {text}" if index else text
        element.attributes["value"] = ",".join(parts)


class Modbus(Section):
    """Signals of Modbus units that the robot polls."""

    name, title = "modbus", "Modbus signal"
    fields = (
        Field("name", "Name", attribute="name"),
        Field("address", "Address of the unit"),
        Field("type", "Type", "choice", choices=tuple(MODBUS_TYPES), attribute="type"),
        Field("register", "Register", "whole", "", 0, 65535, attribute="signalAddress"),
        Field("slave", "Slave", "whole", "", 0, 255, attribute="slaveAddress", default="255"),
        Field("frequency", "Frequency", "choice", "Hz", choices=_RATES, attribute="updateFrequency", default="10"),
    )
    listed = grows = True
    applied = "with the next program"
    places = "`IOs/ModbusUnits/Unit`: `ipAddress`, `ModbusSignal`"

    def rows(self, root: Element) -> list[Row]:
        return [self.read(signal, address=unit.get("ipAddress")) for unit, signal in self._signals(root)]

    def write(self, root: Element, row: Row, changes: Row) -> None:
        unit, signal = next(pair for pair in self._signals(root) if pair[1].get("name") == row["name"])
        self.put(signal, changes)
        if "address" in changes and changes["address"] != row["address"]:
            new = self._unit(root, changes["address"])
            unit.children.remove(signal)
            signal.parent = new
            new.children.append(signal)

    def add(self, root: Element, row: Row) -> None:
        attributes = {
            "class": "ModbusSignal",
            "name": row["name"],
            "type": row["type"],
            "slaveAddress": str(row.get("slave", 255)),
            "updateFrequency": row.get("frequency", "10"),
            "signalAddress": str(row["register"]),
            "loadTestString": "Signal created",
            "modificationChoice": "0",
            "preserveStateAtProgramStop": "true",
            "setLowAtProgramStop": "false",
            "programStateMode": "false",
            "inputAction": "NONE",
        }
        new_element(self._unit(root, row["address"]), "ModbusSignal", attributes)

    def remove(self, root: Element, row: Row) -> None:
        unit, signal = next(pair for pair in self._signals(root) if pair[1].get("name") == row["name"])
        unit.children.remove(signal)
        if not any(child.tag == "ModbusSignal" for child in unit.children) and unit.parent is not None:
            unit.parent.children.remove(unit)

    def _signals(self, root: Element) -> Iterator[tuple[Element, Element]]:
        for unit in self._units(root):
            yield from ((unit, signal) for signal in unit if signal.tag == "ModbusSignal" and signal.get("name"))

    def _units(self, root: Element) -> Element:
        ios = root.child("IOs")
        units = ios.child("ModbusUnits") if ios else None
        if units is None or any(unit.tag != "Unit" for unit in units):
            raise SettingError(
                "this file has its Modbus units in the form of an early PolyScope, which is read and not written: save "
                "it once with a newer one"
            )
        return units

    def _unit(self, root: Element, address: str) -> Element:
        if not re.fullmatch(r"[0-9A-Za-z.:-]+", address):
            raise SettingError(f"{address!r} is not the address of a Modbus unit")
        units = self._units(root)
        found = next((unit for unit in units if unit.get("ipAddress") == address), None)
        return found or new_element(units, "Unit", {"ipAddress": address, "sequentialMode": "false"})


class ExternalControl(Section):
    """The address from which External Control nodes request their program."""

    name, title = "external_control", "External Control"
    fields = (Field("host", "Host IP"), Field("port", "Custom port", "whole", "", 1, 65535))
    applied = "immediately: the next play connects there"
    places = "`Contributions/URCaps/Contributed` of the URCap: `data` with the keys `host_ip`, `name`, `port_nr`"
    _DEFAULTS: Final = {"host_ip": "192.168.56.1", "port_nr": "50002"}
    _URCAP: Final = {
        "ownerId": "com.fzi.externalcontrol",
        "id": "com.fzi.externalcontrol.impl.ExternalControlInstallationNodeService",
        "installationContributionTitle": EXTERNAL_CONTROL,
        "vendor": "FZI Research Center for Information Technology",
        "name": EXTERNAL_CONTROL,
    }

    def rows(self, root: Element) -> list[Row]:
        urcap = self._urcap(root)
        data = {item.get("key"): item.get("value") for item in urcap or ()}
        known = {**self._DEFAULTS, **{key: value for key, value in data.items() if value}}
        port = known["port_nr"]
        return [{"host": known["host_ip"], "port": int(port) if re.fullmatch("[0-9]{1,5}", port) else 50002}]

    def write(self, root: Element, row: Row, changes: Row) -> None:
        host = changes.get("host", row["host"])
        if not host or any(letter.isspace() for letter in host):
            raise SettingError(f"{host!r} is not a host: use an address or a host name")
        urcap = self._urcap(root)
        if urcap is None:
            contributions = root.child("Contributions") or new_element(root, "Contributions", {})
            urcaps = contributions.child("URCaps") or new_element(contributions, "URCaps", {})
            urcap = new_element(urcaps, "Contributed", dict(self._URCAP))
        if "host" in changes:
            self._set(urcap, "host_ip", host)
            self._set(urcap, "name", host)
        if "port" in changes:
            self._set(urcap, "port_nr", str(changes["port"]))

    def _set(self, urcap: Element, key: str, value: str) -> None:
        data = next((item for item in urcap if item.get("key") == key), None)
        if data is not None:
            data.attributes["value"] = value
        elif self._DEFAULTS["port_nr"] != value:  # the URCap does not save the default port
            new_element(urcap, "data", {"key": key, "value": value})

    def _urcap(self, root: Element) -> Element | None:
        named = self._URCAP["name"]
        return next((e for e in root.walk() if e.tag == "Contributed" and e.get("name") == named), None)


class DefaultProgram(Section):
    """Default program: actions of the controller without an operator."""

    name, title = "default_program", "Default program"
    fields = (
        Field("file", "Program file", attribute="fileName"),
        Field("load", "Load it at boot", "flag", attribute="autoLoad"),
        Field("start_pin", "Start it by", attribute="nameOfSensorToAutoStartProgram"),
        Field("start_level", "when the input is high", "flag", attribute="triggerValueToStartProgram"),
        Field("release_pin", "Release the brakes by", attribute="nameOfSensorToInitialize"),
        Field("release_level", "when the input is high", "flag", attribute="triggerValueToInitialize"),
    )
    applied = (
        "immediately for the inputs, at the next boot for the program. A CB3 always obeys the inputs; an e-Series that "
        "enforces remote control obeys them only in remote control"
    )
    places = (
        "`DefaultProgramSettings`: `fileName`, `autoLoad`, `nameOfSensorToInitialize`, `triggerValueToInitialize`, "
        "`nameOfSensorToAutoStartProgram`, `triggerValueToStartProgram`"
    )
    _WRITTEN: Final = (*fields[:2], *fields[4:], *fields[2:4])  # in PolyScope's order
    _INPUTS: Final = ("digital_in", "config_in", "tool_in", "GP_bool_in")

    def rows(self, root: Element) -> list[Row]:
        return [self.read(root.child("DefaultProgramSettings"))]

    def write(self, root: Element, row: Row, changes: Row) -> None:
        updated = {**row, **changes}
        names = {pin["name"]: pin["pin"] for pin in SECTIONS["io"].rows(root) if pin["name"]}
        for purpose in ("start", "release"):
            pin = updated[f"{purpose}_pin"]
            found = find_pin(names.get(pin, pin), {}) if pin else None
            if pin and (found is None or found[0] not in self._INPUTS):
                raise SettingError(
                    f"{pin!r} is not a digital input: digital_in[0], config_in[0], tool_in[0], GP_bool_in[0]"
                )
        if (updated["load"] or updated["start_pin"]) and not updated["file"]:
            raise SettingError(
                "a default program that is loaded or started needs a file: give its path in the programs folder"
            )
        settings = root.child("DefaultProgramSettings") or new_element(root, "DefaultProgramSettings", {})
        ours = {field.attribute for field in self.fields}
        kept = {key: value for key, value in settings.attributes.items() if key not in ours}
        written = {}
        for field in self._WRITTEN:  # without empty values, and without the levels of inputs that are not used
            needed = updated.get(f"{field.name.removesuffix('_level')}_pin", updated[field.name])
            if field.name == "load" or needed:
                written[field.attribute] = field.text(updated[field.name])
        settings.attributes = {**written, **kept}


SECTIONS: Final[Mapping[str, Section]] = {
    section.name: section
    for section in (
        Tcps(), Payloads(), Mounting(), Features(), Pins(), Modbus(), ExternalControl(), DefaultProgram(),
        *SAFETY_SECTIONS,
    )
}  # fmt: skip
"""All sections by name, in the order of the form."""


def read_settings(root: Element) -> dict[str, list[Row]]:
    """The rows of all sections."""
    return {name: read_section(root, name) for name in SECTIONS}


def read_section(root: Element, name: str) -> list[Row]:
    """The rows of a section; empty if this file stores them in an unknown form."""
    try:
        return SECTIONS[name].rows(root)
    except (DocumentError, SettingError):
        return []


def set_driver_address(root: Element, host: str, port: int) -> None:
    """Set the driver address of External Control explicitly, even if it equals the default.

    Raises SettingError, or DocumentError for a document that is not an installation.
    """
    if root.tag != "Installation":
        raise DocumentError(f"<{root.tag}> is not an installation")
    page = SECTIONS[ExternalControl.name]
    page.write(link(root), page.row(root, ""), page.checked({"host": host, "port": port}))


def change_setting(root: Element, section: str, name: str, values: Mapping[str, Any]) -> None:
    """Change some values of a row in the document of a file. Raises SettingError, and then changes nothing.

    name: of the row; ignored for a section with a single row.
    """
    page = _section(section)
    row = page.row(link(root), name)
    checked = page.checked(values)
    changes = {key: value for key, value in checked.items() if value != row[key]}
    if page.grows and page.key in changes:
        _check_new_name(page, root, changes[page.key])
    if changes:
        page.write(root, row, changes)


def add_setting(root: Element, section: str, values: Mapping[str, Any]) -> None:
    """Add a row. Raises SettingError, and then changes nothing."""
    page = _section(section)
    link(root)
    checked = page.checked(values)
    missing = [
        field.title for field in page.fields if not (field.fixed or field.kind == "flag" or field.name in checked)
    ]
    if page.grows and missing:
        raise SettingError(f"{page.title}: missing: {', '.join(missing)}")
    _check_new_name(page, root, checked.get(page.key, ""))
    page.add(root, checked)


def remove_setting(root: Element, section: str, name: str) -> None:
    """Remove a row. Raises SettingError, and then changes nothing."""
    page = _section(section)
    page.remove(root, page.row(link(root), name))


def _section(name: str) -> Section:
    if name not in SECTIONS:
        raise SettingError(f"an installation has no section {name!r}: there are {', '.join(SECTIONS)}")
    return SECTIONS[name]


def _check_new_name(page: Section, root: Element, name: str) -> None:
    if page.grows and not name:
        raise SettingError(f"{page.title}: a name is required")
    if page.grows and any(row[page.key] == name for row in page.rows(root)):
        raise SettingError(f"{page.title}: there is already a {name!r}")


# a new file


def new_installation(version: PolyscopeVersion, name: str = "default") -> Element:
    """The installation of a controller that was never set up: one TCP at the flange, no payload, base on the floor.

    It is as in ``new.installation``, without safety settings, because those depend on the arm
    (`urscript.polyscope.safety_text.settings_text`).
    """
    root = read_document(files("urscript.polyscope").joinpath("new.installation").read_bytes())
    root.attributes["fileName"] = name
    ios, payloads = root.children[0], root.child("PayloadSettings")
    inner, ios.children = ios.children, []
    for tag, kind in PIN_NAMES.items():
        new_element(ios, tag, {"value": ", ".join([""] * _PIN_COUNTS[kind])})
    ios.children += inner
    for tag, kind in PIN_NAMES.items():
        if kind not in _WITHOUT_ACTIONS:
            new_element(ios, tag.removesuffix("Names") + "Actions", {"value": ", ".join(["NONE"] * _PIN_COUNTS[kind])})
    for element in root.walk():
        if element.tag.endswith("Version"):
            numbers_of = {"major": version.major, "minor": version.minor, "bugfix": version.bugfix}
            element.attributes = {part: str(number) for part, number in numbers_of.items()}
        elif "id" in element.attributes:
            element.attributes["id"] = str(uuid.uuid4())
    if payloads is not None and not _SEVERAL_PAYLOADS.covers(version):
        root.children.remove(payloads)
        tcp_settings(root).attributes["toolPayload"] = "0.0"
    return root
