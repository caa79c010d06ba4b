"""Faults: a form for every kind, made of what the emulator says about it, and those that wait, are in force or over."""

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import groupby
from typing import Any, Final

from nicegui import ui

from client.pendant.fault_form import FaultField, FaultKind, arguments_of, fault_kinds
from client.pendant.page import Page

_SUBJECTS: Final = {
    "network": "Connections and ports",
    "line": "Bytes on their way",
    "rtde": "RTDE and shown state",
    "arm": "Arm",
    "program": "Programs",
    "machine": "Controller",
}
_SHOWN_OVER: Final = 20


def faults_tab(page: Page) -> None:
    """Put it there."""
    with ui.element("div").classes("sim-faults"):
        form = _Form(page)
        _list(page)
    page.live.effect(lambda station: station.emulator.catalogue, form.know)


class _Form:
    """The kind that is chosen, and what is in its fields."""

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
        ordered = sorted(self._kinds.values(), key=lambda kind: list(_SUBJECTS).index(kind.subject))
        options = {
            kind.name: f"{_SUBJECTS[subject]}: {kind.title}"
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
        rows = ui.element("div").classes("sim-rows").props("data-testid=faults")

    def show(faults: Sequence[Mapping[str, Any]] | None) -> None:
        rows.clear()
        present = [fault for fault in faults or () if fault["state"] != "over"]
        over = [fault for fault in faults or () if fault["state"] == "over"][: -_SHOWN_OVER - 1 : -1]
        clear.set_enabled(bool(present))
        with rows:
            for fault in (*present, *over):
                _row(page, fault)
            if not faults:
                ui.label("Nothing has gone wrong on purpose yet.").classes("init-hint")

    page.live.effect(lambda station: emulator.watch("faults").value if emulator.available else None, show)


def _row(page: Page, fault: Mapping[str, Any]) -> None:
    over = fault["state"] == "over"
    with ui.element("div").classes("sim-fault").props(f"data-state={'over' if over else 'on'}"):
        ui.label(str(fault["id"])).classes("sim-fault-id")
        with ui.element("div").classes("sim-fault-what"):
            ui.label(fault["kind"].replace("_", " ")).classes("sim-fault-kind")
            ui.label(_details(fault)).classes("init-hint")
            if fault["problem"]:
                ui.label(fault["problem"]).classes("sim-problem")
        ui.label(fault["state"]).classes("sim-chip")
        strikes = fault["strikes"]
        times = f"struck {strikes} time{'' if strikes == 1 else 's'}"
        ui.label(f"{strikes}×").classes("sim-strikes").props(f'title="{times}"')
        if over:
            ui.element("span").classes("sim-no-button")
        else:
            clear = partial(page.station.emulator.change, "clear_fault", fault_id=fault["id"])
            ui.button(icon="close", on_click=page.doing(clear)).props(
                f'flat round dense aria-label="Clear fault {fault["id"]}" data-testid=fault-clear-{fault["id"]}'
            )


def _details(fault: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in fault["arguments"].items())
