"""Faults: a form for each kind, generated from its description, and the list of pending, active and past faults."""

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import groupby
from typing import Any, Final

from nicegui import ui

from client.pendant.fault_form import FaultField, FaultKind, arguments_of, fault_kinds
from client.pendant.page import Page

SUBJECTS: Final = {
    "network": "Connections and ports",
    "line": "Bytes in transit",
    "rtde": "RTDE and published state",
    "arm": "Arm",
    "program": "Programs",
    "machine": "Controller",
    "scene": "Scene",
}
"""What the emulator calls what its faults are about, as the list has it."""

_SHOWN_OVER: Final = 20


def faults_tab(page: Page) -> None:
    """Put it there."""
    with ui.element("div").classes("sim-faults"):
        form = _Form(page)
        _list(page)
    page.live.effect(lambda station: station.emulator.catalogue, form.know)


class _Form:
    """The selected kind of fault, and the content of its fields."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._kinds: dict[str, FaultKind] = {}
        self._inputs: dict[str, Any] = {}
        with ui.element("div").classes("sim-fault-form"):
            self._choice = ui.select({}, label="Kind of fault", on_change=self._chosen, with_input=True)
            self._choice.props("outlined dense options-dense data-testid=fault-kind").classes("sim-wide")
            self._fields = ui.element("div").classes("sim-fault-fields")
            with ui.element("div").classes("sim-row"):
                inject = ui.button("Inject", icon="bolt", on_click=page.doing(self._inject))
                inject.props("unelevated color=negative data-testid=fault-inject").classes("sim-button")

    def know(self, catalogue: Mapping[str, Any]) -> None:
        """What kinds there are."""
        self._kinds = fault_kinds(catalogue.get("fault_kinds", ()), list(catalogue.get("ports", ())))
        ordered = sorted(self._kinds.values(), key=lambda kind: list(SUBJECTS).index(kind.subject))
        options = {
            kind.name: f"{SUBJECTS[subject]}: {kind.title}"
            for subject, group in groupby(ordered, key=lambda kind: kind.subject)
            for kind in group
        }
        self._choice.set_options(options, value=next(iter(options), None))
        self._chosen()

    def _chosen(self) -> None:
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
                self._put(field for field in kind.fields if not field.timing)
            when = ui.expansion("When and how often").props("dense").classes("sim-wide sim-when")
            with when, ui.element("div").classes("sim-grid"):
                self._put(field for field in kind.fields if field.timing)

    def _put(self, fields: Any) -> None:
        for field in fields:
            self._inputs[field.name] = _input(field)

    async def _inject(self) -> None:
        kind = self._kinds.get(self._choice.value or "")
        if kind is None:
            raise ValueError("Choose a kind of fault first.")
        arguments = arguments_of(kind, {name: shown.value for name, shown in self._inputs.items()})
        await self._page.station.emulator.change("inject_fault", kind=kind.name, **arguments)


def _input(field: FaultField) -> Any:
    mark = f"outlined dense hide-bottom-space data-testid=fault-{field.name}"
    label = field.name + (" *" if field.required else "")
    if field.type == "bool":
        return ui.checkbox(label, value=bool(field.default)).props(f"dense data-testid=fault-{field.name}")
    if field.choices:
        return ui.select(dict(field.choices), label=label, value=field.default).props(mark + " options-dense")
    shown = "" if field.default is None else str(field.default)
    box = ui.input(label, value=shown, placeholder=field.hint).props(f"{mark} stack-label")
    return box.classes("number") if field.type != "text" else box


def _list(page: Page) -> None:
    emulator = page.station.emulator
    with ui.element("div").classes("sim-fault-list"):
        with ui.element("div").classes("sim-row sim-list-head"):
            ui.label("Faults").classes("panel-title")
            ui.space()
            clear = ui.button("Clear all", on_click=page.doing(lambda: emulator.change("clear_faults")))
            clear.props("flat dense no-caps icon=delete_sweep data-testid=faults-clear").classes("sim-button")
        listed = ui.element("div").classes("sim-rows").props("data-testid=faults")
        listed.props('tabindex=0 role=region aria-label="Faults so far"')
        with listed:
            nothing = ui.label("No faults have been injected yet.").classes("init-hint")
    rows = dict[tuple[object, ...], _Row]()

    def show(faults: Sequence[Mapping[str, Any]] | None) -> None:
        present = [fault for fault in faults or () if fault["state"] != "over"]
        over = [fault for fault in faults or () if fault["state"] == "over"][: -_SHOWN_OVER - 1 : -1]
        wanted = {_Row.key(fault): fault for fault in (*present, *over)}
        clear.set_enabled(bool(present))
        nothing.set_visibility(not wanted)
        for key in rows.keys() - wanted.keys():
            rows.pop(key).element.delete()
        for place, (key, fault) in enumerate(wanted.items(), start=1):
            if key not in rows:
                with listed:
                    rows[key] = _Row(page, fault)
            row = rows[key]
            row.show(fault)
            if listed.default_slot.children.index(row.element) != place:
                row.element.move(target_index=place)

    page.live.effect(lambda station: emulator.watch("faults").value if emulator.available else None, show)


class _Row:
    """A fault in the list. It stays as long as the fault, because a click on an element being replaced is lost."""

    def __init__(self, page: Page, fault: Mapping[str, Any]) -> None:
        over = fault["state"] == "over"
        self.element = ui.element("div").classes("sim-fault").props(f"data-state={'over' if over else 'on'}")
        with self.element:
            ui.label(str(fault["id"])).classes("sim-fault-id")
            with ui.element("div").classes("sim-fault-what"):
                ui.label(fault["kind"].replace("_", " ")).classes("sim-fault-kind")
                ui.label(_details(fault)).classes("init-hint")
                self._problem = ui.label().classes("sim-problem")
            self._state = ui.label().classes("sim-chip")
            self._strikes = ui.label().classes("sim-strikes")
            if over:
                ui.element("span").classes("sim-no-button")
            else:
                clear = partial(page.station.emulator.change, "clear_fault", fault_id=fault["id"])
                ui.button(icon="close", on_click=page.doing(clear)).props(
                    f'flat round dense aria-label="Clear fault {fault["id"]}" data-testid=fault-clear-{fault["id"]}'
                )

    @staticmethod
    def key(fault: Mapping[str, Any]) -> tuple[object, ...]:
        """What stays the same in a row. An emulator that was started anew counts from one again."""
        return fault["id"], fault["kind"], _details(fault), fault["state"] == "over"

    def show(self, fault: Mapping[str, Any]) -> None:
        """What may change."""
        strikes = fault["strikes"]
        times = f"struck {strikes} time{'' if strikes == 1 else 's'}"
        self._problem.set_text(fault["problem"] or "")
        self._problem.set_visibility(bool(fault["problem"]))
        self._state.set_text(fault["state"])
        self._strikes.set_text(f"{strikes}×")
        self._strikes.props(f'title="{times}"')


def _details(fault: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in fault["arguments"].items())
