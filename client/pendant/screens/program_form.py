"""The form of the selected node, generated from the fields of its type: new types and fields need no code here."""

from collections.abc import Callable, Mapping
from math import degrees
from typing import Any, Final

from nicegui import ui

from client.pendant.page import EXPECTED_ERRORS, Page
from client.pendant.program_draft import Selection
from client.pendant.program_view import FormField
from client.pendant.screens.move_jog import MoveSettings
from client.pendant.situation import Action
from client.pendant.station import Station
from urproto.errors import RobotRefused
from urproto.text import readable

_SELECT_KINDS: Final = ("choice", "pin", "tcp", "feature", "subprogram")  # kinds of fields whose values are in a list
_NUMBER_KINDS: Final = ("number", "integer")
_POSITION_KIND: Final = "position"


class NodeForm:
    """The panel with the form. It is rebuilt when another node is selected or when other fields apply.

    The attribute ``data-node`` of the fields names their node: they arrive a moment after the tree shows the selection.
    """

    def __init__(self, page: Page, selection: Selection) -> None:
        self._page = page
        self._selection = selection
        self._draft = page.station.program_draft
        self._setters = dict[str, Callable[[Any], object]]()  # sets the shown value of a field
        self._shown_values = dict[str, Any]()  # the values that were shown last
        self._node = ""  # the node whose fields are shown
        self._on_leave = list[
            Callable[[], None]
        ]()  # commits the content of a field that is removed, or shows why it is invalid
        self._settings = MoveSettings(page)
        with ui.card().classes("panel program-form").props('role=form aria-label="Selected node"') as self._panel:
            page.live.text(lambda _: self._draft.view.text(selection.node), "panel-title").props(
                "data-testid=form-title"
            )
            page.live.text(lambda _: self._draft.view.doc(selection.node), "program-doc")
            problem = page.live.text(lambda _: self._draft.view.problem(selection.node), "program-form-problem")
            problem.props("role=status data-testid=form-problem")
            self._fields = ui.element("div").classes("program-fields")
        page.live.effect(self._field_layout, lambda _: self._rebuild())
        page.live.effect(self._field_values, self._show_changes)

    @property
    def fields_id(self) -> int:
        return self._fields.id

    def focus(self) -> None:
        ui.run_javascript(f"pendantProgram.edit({self.fields_id})")

    # fields

    def _form_fields(self) -> tuple[FormField, ...]:
        return self._draft.view.form(self._selection.node)

    def _field_layout(self, _: Station) -> tuple[object, ...]:
        fields = self._form_fields()
        return (self._selection.node, *((field.key, field.kind, field.unit, field.choices) for field in fields))

    def _field_values(self, _: Station) -> tuple[object, ...]:
        return tuple((field.key, field.value) for field in self._form_fields())

    def _show_changes(self, values: tuple[tuple[str, Any], ...]) -> None:
        """Show changes by other browsers or by undo; a text that is being typed in another field stays."""
        previous, self._shown_values = self._shown_values, dict(values)
        for key, value in values:
            if key in self._setters and not (key in previous and previous[key] == value):
                self._setters[key](value)

    def _rebuild(self) -> None:
        node = self._selection.node
        if node != self._node and self._draft.view.has(self._node):
            for leave in self._on_leave:
                leave()
        self._fields.clear()
        self._setters.clear()
        self._on_leave.clear()
        self._node, form = node, self._form_fields()
        self._shown_values = {field.key: field.value for field in form}
        self._fields.props(f'data-node="{node}"')
        with self._fields:
            for field in form:
                if field.kind == _POSITION_KIND:
                    self._position_field(node, field)
                elif field.kind == "boolean":
                    self._checkbox_field(node, field)
                elif field.kind in _SELECT_KINDS:
                    self._select_field(node, field)
                else:
                    self._text_field(node, field)

    # kinds of fields

    def _set_value(self, node: str, field: FormField, value: Any) -> str:
        """Set a field; returns the problem of the value, "" without one."""
        try:
            self._draft.set(node, field.key, value)
        except EXPECTED_ERRORS as error:
            return readable(str(error))
        return ""

    def _text_field(self, node: str, field: FormField) -> None:
        """A field for a number, a text, an expression or a variable."""
        suggestions = [str(value) for value, _ in field.choices]
        box = ui.input(field.title, value=_text(field.value), autocomplete=suggestions or None)
        box.props(
            f'dense outlined data-testid=field-{field.key} spellcheck=false aria-label="{_label_with_unit(field)}"'
        )
        if field.unit:
            box.props(f'stack-label suffix="{field.unit}"')
        if field.kind in _NUMBER_KINDS:
            box.props("inputmode=decimal")
        if field.help:
            box.props(f'hint="{field.help}"')

        committed = _text(field.value)  # the last typed text, which is in the program or known to be invalid

        def commit() -> None:
            nonlocal committed
            if (text := box.value or "") == committed:
                return
            committed = text
            problem = ""
            if text != _text(self._draft.view.value(node, field.key)):
                problem = self._set_value(node, field, None if text == "" and field.optional else text)
            box.error = problem or None

        def leave() -> None:
            commit()
            if box.error:
                self._page.show_error(f"{self._draft.view.text(node)}, {field.title}: {box.error}")

        def show(value: Any) -> None:
            nonlocal committed
            committed = _text(value)
            box.set_value(committed)
            box.error = None

        box.on("blur", commit)
        box.on("keydown.enter", commit)
        self._on_leave.append(leave)
        self._setters[field.key] = show

    def _select_field(self, node: str, field: FormField) -> None:
        options = dict(field.choices)
        if field.value not in (None, "") and field.value not in options:
            options[str(field.value)] = str(field.value)  # no longer in the installation, which the node reports
        value = field.value if field.value in options else None
        select = ui.select(options, label=field.title, value=value, clearable=field.optional)
        select.props(
            f'dense outlined options-dense data-testid=field-{field.key} aria-label="{_label_with_unit(field)}"'
        )

        def choose() -> None:
            if problem := self._set_value(node, field, select.value):
                self._page.show_error(problem)
                select.set_value(self._draft.view.value(node, field.key))

        select.on("update:model-value", choose)
        self._setters[field.key] = lambda value: select.set_value(value if value in select.options else None)

    def _checkbox_field(self, node: str, field: FormField) -> None:
        box = ui.checkbox(field.title, value=bool(field.value)).props(f"data-testid=field-{field.key}")

        def choose() -> None:
            if problem := self._set_value(node, field, box.value):
                self._page.show_error(problem)
                box.set_value(bool(self._draft.view.value(node, field.key)))

        box.on("update:model-value", choose)
        self._setters[field.key] = lambda value: box.set_value(bool(value))

    def _position_field(self, node: str, field: FormField) -> None:
        """A position that is taught from the arm, and a button that moves the arm there."""
        page = self._page
        shown = ui.label(_position_text(field.value)).classes("program-doc").props(f"data-testid=field-{field.key}")
        self._setters[field.key] = lambda value: shown.set_text(_position_text(value))

        def teach() -> None:
            values = page.station.values
            if "actual_q" not in values or "actual_TCP_pose" not in values:
                raise RobotRefused("teaching", "the robot has not reported where it is", "wait until it is connected")
            tcp = values.get("tcp_offset") or (0.0,) * 6
            self._draft.teach(node, field.key, values["actual_q"], values["actual_TCP_pose"], tcp)

        async def move() -> None:
            joints = self._draft.view.joints(node, field.key)
            if joints is None:
                raise ValueError(f"{field.title} was never taught")
            activity = f"Moving to {self._draft.view.text(node)}"
            await self._settings.move(lambda: page.station.mover.move_j(joints, activity, **self._settings.joint_speed))

        with ui.row().classes("target-buttons"):
            teach_button = ui.button(f"Teach {field.title.lower()}", icon="my_location", on_click=page.handler(teach))
            page.needs_robot(teach_button)
            teach_button.props(f"unelevated no-caps data-testid=teach-{field.key}")
            move_button = ui.button("Move here", icon="near_me").props(f"flat no-caps data-testid=move-{field.key}")
            page.bind_button(Action.MOVE, move, move_button)


def _label_with_unit(field: FormField) -> str:
    return f"{field.title} in {field.unit}" if field.unit else field.title


def _text(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _position_text(value: Any) -> str:
    if not isinstance(value, Mapping) or not value.get("joints"):
        return "Not taught yet"
    return "Joints " + ", ".join(f"{degrees(angle):.1f}°" for angle in value["joints"])
