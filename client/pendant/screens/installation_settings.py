"""The installation file of an emulator: forms for all settings, generated from the table of settings."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from nicegui import ui

from client.pendant.page import Page, Views
from client.pendant.station import Station
from urscript.polyscope.installation_sections import UNITS, Field, Row, Section
from urscript.polyscope.installation_settings import SECTIONS, Pins

_AXES: Final = ("X", "Y", "Z", "RX", "RY", "RZ")
_VIEW: Final = "file"


def can_be_saved(station: Station) -> bool:
    """Whether the robot is an emulator that has installation files."""
    return station.emulator.available and "change_installation" in station.emulator.verbs


def build(page: Page, views: Views) -> None:
    with page.panel("Installation file", "installation-panel") as panel:
        _Form(page, views)
    with page.panel("Installation file", "installation-panel") as real:
        ui.label(
            "The installation of a robot is saved by its own teach pendant. What it takes over public ports is under "
            "Settings."
        )
    page.show_if(panel, can_be_saved)
    page.show_if(real, lambda station: not can_be_saved(station))


class _Form:
    """The form of one section, one list entry at a time. Typed values stay until they are saved or the form is left."""

    def __init__(self, page: Page, views: Views) -> None:
        self._page, self._views = page, views
        self._section: Section = next(iter(SECTIONS.values()))
        self._rows: list[Row] | None = None  # None until the emulator has answered for the section
        self._sections_shown = 0
        self._row: Row | None = None  # None while a new one is being entered
        self._inputs: dict[str, _Input] = {}
        with ui.element("div").classes("setting-choice"):
            choice = ui.select({name: section.title for name, section in SECTIONS.items()}, label="Setting")
            choice.props("outlined dense options-dense data-testid=setting").set_value(self._section.name)
            choice.on_value_change(lambda change: self._show_section(change.value))
            self._row_select = ui.select({}, label="Which", with_input=True, on_change=self._show_row)
            self._row_select.props("outlined dense options-dense data-testid=setting-row")
        self._note = ui.label().classes("soft").props("data-testid=setting-note")
        self._fields = ui.element("div").classes("setting-fields")
        with ui.row().classes("tcp-buttons"):
            self._save_button = _button(
                "Save", page.handler(self._save, "Saved in the installation file"), "setting-save"
            )
            self._add_button = _button("Add as new", page.handler(self._add, "Added"), "setting-add", "outline")
            self._remove_button = _button("Remove", page.handler(self._remove, "Removed"), "setting-remove", "flat")
        self._file = ui.label().classes("soft").props("data-testid=setting-file")
        page.live.effect(self._read_installation, self._update)
        self._show_section(self._section.name)

    # answers of the emulator

    def _read_installation(self, station: Station) -> tuple[int, Mapping[str, Any] | None]:
        """The answer, and for which section: one that is shown again needs the same answer again."""
        if self._views.visible_view != _VIEW or not can_be_saved(station):
            return self._sections_shown, None
        answer: Mapping[str, Any] | None = station.emulator.watch("installation", section=self._section.name).value
        return self._sections_shown, answer

    def _update(self, numbered_answer: tuple[int, Mapping[str, Any] | None]) -> None:
        section, (_, answer) = self._section, numbered_answer
        if answer is None or section.name not in answer["sections"]:
            return
        rows = self._rows = answer["sections"][section.name]
        self._file.set_text(f"File: {answer['file']}")
        if section.listed:
            names = [row[section.key] for row in rows]
            shown = self._row_select.value if self._row_select.value in names else next(iter(names), None)
            self._row_select.set_options({row[section.key]: _row_title(row) for row in rows}, value=shown)
        self._show_row()

    # selection

    def _show_section(self, name: str) -> None:
        section = self._section = SECTIONS[name]
        self._sections_shown += 1
        self._rows, self._row, self._inputs = None, None, {}
        self._fields.clear()
        self._row_select.set_options({}, value=None)
        self._row_select.set_visibility(section.listed)
        self._add_button.set_visibility(section.grows)
        self._remove_button.set_visibility(section.grows)
        self._note.set_text(f"Takes effect {section.applied}.".replace("`", ""))
        self._page.station.emulator.watch("installation", section=name).invalidate()

    def _show_row(self) -> None:
        section = self._section
        if self._rows is None:
            return  # fields shown now would be replaced by the answer, with what was typed
        row = next(
            (row for row in self._rows if not section.listed or row[section.key] == self._row_select.value), None
        )
        same_row = row is not None and self._row is not None and row[section.key] == self._row[section.key]
        if same_row and self._inputs and any(field.changed for field in self._inputs.values()):
            self._row = row  # the user is typing; only changed fields will be saved
            return
        if row is None and self._inputs:
            return
        self._row = row
        self._fields.clear()
        with self._fields:
            self._inputs = {field.name: _Input(field, row) for field in section.fields if not field.fixed}

    # changes

    async def _save(self) -> None:
        if self._row is None:
            raise ValueError("there is nothing to change: add it as new")
        values = {name: field.value() for name, field in self._inputs.items() if field.changed}
        if not values:
            raise ValueError("nothing was changed")
        section, name = self._section, str(self._row[self._section.key]) if self._section.listed else ""
        await self._change("change_installation", section=section.name, name=name, values=values)
        if section.listed:
            self._select_row(values.get(section.key, name))

    async def _add(self) -> None:
        values = {name: field.value() for name, field in self._inputs.items()}
        await self._change("add_to_installation", section=self._section.name, values=values)
        self._select_row(values[self._section.key])

    async def _remove(self) -> None:
        if self._row is not None:
            name = self._row[self._section.key]
            await self._change("remove_from_installation", section=self._section.name, name=name)

    async def _change(self, verb: str, **arguments: Any) -> None:
        await self._page.station.emulator.change(verb, **arguments)
        self._row, self._inputs = None, {}

    def _select_row(self, name: str) -> None:
        """Select the row of this name, which may not have arrived yet."""
        self._row_select.set_options(
            {row[self._section.key]: _row_title(row) for row in self._rows or ()} | {name: name}, value=name
        )


class _Input:
    """The fields of one value, in the units of the screen."""

    def __init__(self, field: Field, row: Row | None) -> None:
        self._field = field
        value = None if row is None else row[field.name]
        props = f"outlined dense hide-bottom-space data-testid=setting-{field.name}"
        self._boxes: list[Any]
        if field.kind == "flag":
            box = ui.checkbox(field.title, value=bool(value)).props(f"dense data-testid=setting-{field.name}")
            self._boxes = [box]
        elif field.kind == "choice" or field.name == "action":
            options = field.choices or (Pins.actions_of(row) if row else ())
            label = f"{field.title} [{field.unit}]" if field.unit else field.title
            known = value if value in options else next(iter(options), None)
            self._boxes = [ui.select(list(options), label=label, value=known).props(props)]
        elif field.kind == "text":
            self._boxes = [ui.input(field.title, value=value or "").props(props)]
        else:
            self._boxes = self._numbers(field, value, props)
        self._initial = [box.value for box in self._boxes]

    def _numbers(self, field: Field, value: Any, props: str) -> list[Any]:
        values: Sequence[Any] = value if isinstance(value, list) else [value]
        if field.kind in ("vector", "pose") and value is None:
            values = [0.0] * (3 if field.kind == "vector" else 6)
        boxes = []
        if len(values) > 1:
            ui.label(field.title).classes("soft")
        with ui.element("div").classes("six" if len(values) > 1 else "setting-one"):
            for index, number in enumerate(values):
                unit, factor = _unit_and_factor(field, index)
                name = _AXES[index] if len(values) > 1 else field.title
                box = ui.number(f"{name} [{unit}]" if unit else name)
                box.set_value(None if number is None else round(number * factor, 9) + 0.0)
                boxes.append(box.props(props if len(values) == 1 else f"{props}-{index}"))
        self._exact_values = list(values)
        return boxes

    @property
    def changed(self) -> bool:
        return [box.value for box in self._boxes] != self._initial

    def value(self) -> Any:
        """The value in SI units; an unchanged number keeps all its digits. Raises ValueError."""
        field = self._field
        if field.kind in ("flag", "text", "choice"):
            return self._boxes[0].value
        numbers = []
        for index, (box, initial) in enumerate(zip(self._boxes, self._initial, strict=True)):
            if box.value is None:
                raise ValueError(f"{field.title}: a number is missing")
            factor = _unit_and_factor(field, index)[1]
            numbers.append(self._exact_values[index] if box.value == initial else box.value / factor)
        if field.kind in ("vector", "pose"):
            return numbers
        return int(numbers[0]) if field.kind == "whole" and float(numbers[0]).is_integer() else numbers[0]


def _unit_and_factor(field: Field, index: int) -> tuple[str, float]:
    if field.kind == "pose" and index > 2:
        return "rad", 1.0
    return UNITS.get(field.unit, (field.unit, 1.0))


def _row_title(row: Row) -> str:
    first, second = str(next(iter(row.values()))), str(row.get("name", ""))
    return first if first == second else f"{first} {second}".strip()


def _button(text: str, on_click: Callable[[], Any], test_id: str, style: str = "") -> ui.button:
    return ui.button(text, on_click=on_click).props(f"no-caps {style} data-testid={test_id}")
