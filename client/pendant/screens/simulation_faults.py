"""Faults: a form for each kind, generated from its description, and the list of pending, active and past faults."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import Any, Final, Literal

from nicegui import ui

from client.pendant.page import Page
from urproto.joints import JOINT_LABELS

SUBJECTS: Final = {
    "network": "Connections and ports",
    "line": "Bytes in transit",
    "rtde": "RTDE and published state",
    "arm": "Arm",
    "program": "Programs",
    "machine": "Controller",
    "scene": "Scene",
}
"""Titles of the subjects of the emulator's faults, in the order of the list."""

_MAX_PAST_SHOWN: Final = 20
TIMING: Final = ("at", "after", "until", "lasting", "once", "probability", "seed")
"""Arguments of every kind, or of every kind that strikes on an occasion."""

_HINTS: Final = {
    "at": "uptime, s",
    "after": "s from now",
    "until": "uptime, s",
    "lasting": "s",
    "peer": "address or address:port; all",
    "probability": "of a strike, 0 to 1",
    "delay_s": "s",
    "stop_above_rad": "rad; 0: no stop",
}
_ALL_PORTS: Final = "all ports"
_SCRIPTS: Final = "scripts"  # the connections that programs open: docs/faults.md
JOINTS: Final = dict(enumerate(JOINT_LABELS))


@dataclass(frozen=True, slots=True)
class FaultField:
    """One argument of a fault. choices: value -> text, empty for a typed value. required: it has no default."""

    name: str
    type: Literal["text", "int", "float", "bool"]
    default: Any
    required: bool
    choices: Mapping[Any, str]
    hint: str = ""

    @property
    def is_timing(self) -> bool:
        return self.name in TIMING

    def parse(self, value: Any) -> Any:
        """Convert the content of the field, None if it is empty. Raises ValueError if it is invalid."""
        if value is None or value == "":
            return None
        if self.type == "bool" or self.choices:
            return value
        try:
            return _PARSERS[self.type](value)
        except (TypeError, ValueError) as error:
            expected = "a whole number" if self.type == "int" else "a number"
            raise ValueError(f"{self.name} must be {expected}, not {value!r}.") from error


@dataclass(frozen=True, slots=True)
class FaultKind:
    """A kind of fault. occasion: the event at which it strikes, empty for a fault that lasts."""

    name: str
    subject: str
    text: str
    occasion: str
    fields: tuple[FaultField, ...]

    @property
    def title(self) -> str:
        return self.name.replace("_", " ").capitalize().replace("rtde", "RTDE")


def fault_kinds(listed: Sequence[Mapping[str, Any]], ports: Sequence[str]) -> dict[str, FaultKind]:
    """The kinds of faults by name, from the results of the verbs ``fault_kinds`` and ``ports``."""
    return {
        kind["kind"]: FaultKind(
            kind["kind"],
            kind["subject"],
            " ".join(kind["text"].replace("``", "").split()),
            kind["occasion"],
            tuple(_field(argument, ports) for argument in kind["arguments"]),
        )
        for kind in listed
    }


def fault_arguments(kind: FaultKind, values: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments for ``inject_fault`` from the content of the fields, without empty ones and defaults.

    Raises ValueError if one is missing or invalid.
    """
    parsed = {field.name: field.parse(values.get(field.name)) for field in kind.fields}
    missing = [field.name for field in kind.fields if field.required and parsed[field.name] is None]
    if missing:
        raise ValueError(f"{kind.title} needs {', '.join(missing)}.")
    return {
        field.name: parsed[field.name]
        for field in kind.fields
        if parsed[field.name] is not None and (field.required or parsed[field.name] != field.default)
    }


def _field(argument: Mapping[str, Any], ports: Sequence[str]) -> FaultField:
    name, kind = argument["name"], argument["type"]
    default, required = argument.get("default"), "default" not in argument
    hint = _HINTS.get(name, "")
    if name == "port" and kind == "str":
        names = [*(port for port in ports if port != "control"), _SCRIPTS]
        all_ports = {} if required else {"": _ALL_PORTS}
        return FaultField(name, "text", default, required, {**all_ports, **{port: port for port in names}}, hint)
    if name == "joint":
        return FaultField(name, "int", default, required, JOINTS, hint)
    if " or " in kind or kind not in ("str", "int", "float", "bool"):
        return FaultField(name, "text", default, required, {word: word for word in kind.split(" or ")}, hint)
    return FaultField(name, "text" if kind == "str" else kind, default, required, {}, hint)


def _whole_number(value: Any) -> int:
    if float(value) != int(float(value)):
        raise ValueError(value)
    return int(float(value))


_PARSERS: Final[Mapping[str, Callable[[Any], Any]]] = {"int": _whole_number, "float": float, "text": str}


def faults_tab(page: Page) -> None:
    with ui.element("div").classes("sim-faults"):
        form = _Form(page)
        _fault_list(page)
    page.live.effect(lambda station: station.emulator.catalogue, form.set_catalogue)


class _Form:
    """The selected kind of fault, and the content of its fields."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._kinds: dict[str, FaultKind] = {}
        self._inputs: dict[str, Any] = {}
        with ui.element("div").classes("sim-fault-form"):
            self._choice = ui.select({}, label="Kind of fault", on_change=self._show_fields, with_input=True)
            self._choice.props("outlined dense options-dense data-testid=fault-kind").classes("sim-wide")
            self._fields = ui.element("div").classes("sim-fault-fields")
            with ui.element("div").classes("sim-row"):
                inject = ui.button("Inject", icon="bolt", on_click=page.handler(self._inject))
                inject.props("unelevated color=negative data-testid=fault-inject").classes("sim-button")

    def set_catalogue(self, catalogue: Mapping[str, Any]) -> None:
        self._kinds = fault_kinds(catalogue.get("fault_kinds", ()), list(catalogue.get("ports", ())))
        ordered = sorted(self._kinds.values(), key=lambda kind: list(SUBJECTS).index(kind.subject))
        options = {
            kind.name: f"{SUBJECTS[subject]}: {kind.title}"
            for subject, group in groupby(ordered, key=lambda kind: kind.subject)
            for kind in group
        }
        self._choice.set_options(options, value=next(iter(options), None))
        self._show_fields()

    def _show_fields(self) -> None:
        self._fields.clear()
        self._inputs = {}
        kind = self._kinds.get(self._choice.value or "")
        if kind is None:
            return
        with self._fields:
            ui.label(kind.text).classes("sim-text").props("data-testid=fault-text")
            if kind.occasion:
                ui.label(f"Strikes on {kind.occasion}.").classes("init-hint")
            with ui.element("div").classes("sim-grid"):
                self._add_inputs(field for field in kind.fields if not field.is_timing)
            timing_section = ui.expansion("When and how often").props("dense").classes("sim-wide sim-when")
            with timing_section, ui.element("div").classes("sim-grid"):
                self._add_inputs(field for field in kind.fields if field.is_timing)

    def _add_inputs(self, fields: Any) -> None:
        for field in fields:
            self._inputs[field.name] = _input(field)

    async def _inject(self) -> None:
        kind = self._kinds.get(self._choice.value or "")
        if kind is None:
            raise ValueError("Choose a kind of fault first.")
        arguments = fault_arguments(kind, {name: shown.value for name, shown in self._inputs.items()})
        await self._page.station.emulator.change("inject_fault", kind=kind.name, **arguments)


def _input(field: FaultField) -> Any:
    props = f"outlined dense hide-bottom-space data-testid=fault-{field.name}"
    label = field.name + (" *" if field.required else "")
    if field.type == "bool":
        return ui.checkbox(label, value=bool(field.default)).props(f"dense data-testid=fault-{field.name}")
    if field.choices:
        return ui.select(dict(field.choices), label=label, value=field.default).props(props + " options-dense")
    shown = "" if field.default is None else str(field.default)
    box = ui.input(label, value=shown, placeholder=field.hint).props(f"{props} stack-label")
    return box.classes("number") if field.type != "text" else box


def _fault_list(page: Page) -> None:
    emulator = page.station.emulator
    with ui.element("div").classes("sim-fault-list"):
        with ui.element("div").classes("sim-row sim-list-head"):
            ui.label("Faults").classes("panel-title")
            ui.space()
            clear = ui.button("Clear all", on_click=page.handler(lambda: emulator.change("clear_faults")))
            clear.props("flat dense no-caps icon=delete_sweep data-testid=faults-clear").classes("sim-button")
        fault_list = ui.element("div").classes("sim-rows").props("data-testid=faults")
        fault_list.props('tabindex=0 role=region aria-label="Faults so far"')
        with fault_list:
            empty_label = ui.label("No faults have been injected yet.").classes("init-hint")
    rows = dict[tuple[object, ...], _Row]()

    def show(faults: Sequence[Mapping[str, Any]] | None) -> None:
        current = [fault for fault in faults or () if fault["state"] != "over"]
        past = [fault for fault in faults or () if fault["state"] == "over"][: -_MAX_PAST_SHOWN - 1 : -1]
        shown_faults = {_Row.key(fault): fault for fault in (*current, *past)}
        clear.set_enabled(bool(current))
        empty_label.set_visibility(not shown_faults)
        for key in rows.keys() - shown_faults.keys():
            rows.pop(key).element.delete()
        for index, (key, fault) in enumerate(shown_faults.items(), start=1):
            if key not in rows:
                with fault_list:
                    rows[key] = _Row(page, fault)
            row = rows[key]
            row.show(fault)
            if fault_list.default_slot.children.index(row.element) != index:
                row.element.move(target_index=index)

    page.live.effect(lambda station: emulator.read("faults"), show)


class _Row:
    """A fault in the list. It stays as long as the fault, because a click on an element being replaced is lost."""

    def __init__(self, page: Page, fault: Mapping[str, Any]) -> None:
        past = fault["state"] == "over"
        self.element = ui.element("div").classes("sim-fault").props(f"data-state={'over' if past else 'on'}")
        with self.element:
            ui.label(str(fault["id"])).classes("sim-fault-id")
            with ui.element("div").classes("sim-fault-what"):
                ui.label(fault["kind"].replace("_", " ")).classes("sim-fault-kind")
                ui.label(_arguments_text(fault)).classes("init-hint")
                self._problem = ui.label().classes("sim-problem")
            self._state = ui.label().classes("sim-chip")
            self._strikes = ui.label().classes("sim-strikes")
            if past:
                ui.element("span").classes("sim-no-button")
            else:
                clear = partial(page.station.emulator.change, "clear_fault", fault_id=fault["id"])
                ui.button(icon="close", on_click=page.handler(clear)).props(
                    f'flat round dense aria-label="Clear fault {fault["id"]}" data-testid=fault-clear-{fault["id"]}'
                )

    @staticmethod
    def key(fault: Mapping[str, Any]) -> tuple[object, ...]:
        """The constant part of a row. A restarted emulator counts from one again."""
        return fault["id"], fault["kind"], _arguments_text(fault), fault["state"] == "over"

    def show(self, fault: Mapping[str, Any]) -> None:
        strikes = fault["strikes"]
        times = f"struck {strikes} time{'' if strikes == 1 else 's'}"
        self._problem.set_text(fault["problem"] or "")
        self._problem.set_visibility(bool(fault["problem"]))
        self._state.set_text(fault["state"])
        self._strikes.set_text(f"{strikes}×")
        self._strikes.props(f'title="{times}"')


def _arguments_text(fault: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in fault["arguments"].items())
