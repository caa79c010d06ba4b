"""Tool centre points: the active one and the saved ones."""

from collections.abc import Callable, Sequence
from typing import Any, Final

from nicegui import ui

from client.errors import FileError
from client.pendant.page import Page
from client.pendant.readings import entered_pose, rotation_names, shown_pose
from client.pendant.settings import active_tcp, apply_tcp, same_tcp
from client.pendant.station import Station
from urproto.robots.pose import Pose

_MM: Final = 1000.0
_FLANGE: Final = "Flange"  # the predefined TCP


def build(page: Page) -> None:
    with page.panel("Tool centre point", "tcp-panel"):
        _Editor(page)


class _Editor:
    def __init__(self, page: Page) -> None:
        self._page = page
        self._as_rpy = False
        self._active_tcp()
        ui.separator()
        with ui.row().classes("tcp-head"):
            self._name = ui.input("Name").props("dense outlined data-testid=tcp-name").classes("tcp-name")
            ui.toggle({False: "Rotation vector [rad]", True: "RPY [°]"}, value=False).props(
                "dense no-caps unelevated data-testid=tcp-form"
            ).on_value_change(lambda change: self._change_form(change.value))
        with ui.element("div").classes("six"):
            props = "dense outlined hide-bottom-space data-testid=tcp-"
            self._boxes = [ui.number(value=0.0).props(f"{props}{index}") for index in range(6)]
        self._label_boxes()
        with ui.row().classes("tcp-buttons"):
            self._page.needs_robot(ui.button("Use it", on_click=lambda: self._apply(self._entered))).props(
                "no-caps data-testid=tcp-use"
            )
            ui.button("Save", on_click=page.handler(self._save, "Saved")).props("outline no-caps data-testid=tcp-save")
            self._page.needs_robot(ui.button("Copy the one in effect", on_click=self._copy_active)).props(
                "flat no-caps"
            )
        self._list = ui.element("div").classes("tcp-list")
        page.live.effect(lambda station: station.tools.version, lambda _: self._show_list())
        ui.label("In effect until a program or an installation sets another one.").classes("soft")

    # the active TCP

    def _active_tcp(self) -> None:
        live = self._page.live
        with ui.element("div").classes("six now"):
            for index, name in enumerate(("X", "Y", "Z", "RX", "RY", "RZ")):
                with ui.element("div").classes("active-value"):
                    ui.label(name)
                    live.text(_element_text(index)).props(f"data-testid=tcp-active-{index}")
        with ui.row().classes("items-center"):
            ui.label("In effect:").classes("soft")
            live.text(_saved_name, "tcp-known").props("data-testid=tcp-active")

    # the form

    def _entered(self) -> Pose:
        """The entered TCP. Raises ValueError if a number is missing."""
        values = [box.value for box in self._boxes]
        if any(value is None for value in values):
            raise ValueError("a TCP has six numbers: fill in all of them")
        return entered_pose(values, self._as_rpy)

    def _show(self, tcp: Sequence[float]) -> None:
        for box, value in zip(self._boxes, shown_pose(tcp, self._as_rpy), strict=True):
            box.set_value(round(value, 6) + 0.0)

    def _label_boxes(self) -> None:
        for box, name in zip(self._boxes, ("X [mm]", "Y [mm]", "Z [mm]", *rotation_names(self._as_rpy)), strict=True):
            box.props(f'label="{name}"')

    def _change_form(self, as_rpy: bool) -> None:
        try:
            entered = self._entered()
        except ValueError:
            entered = None
        self._as_rpy = as_rpy
        self._label_boxes()
        if entered is not None:
            self._show(entered)

    def _copy_active(self) -> None:
        tcp = active_tcp(self._page.station)
        if tcp is not None:
            self._show(tcp)

    # actions

    async def _apply(self, tcp: Callable[[], Sequence[float]]) -> None:
        await self._page.attempt(lambda: apply_tcp(self._page.station, tcp()), "TCP in use")

    def _save(self) -> None:
        self._page.station.tools.save(self._name.value or "", self._entered())

    def _show_list(self) -> None:
        self._list.clear()
        with self._list:
            for name, tcp in {_FLANGE: (0.0,) * 6, **self._saved()}.items():
                self._add_row(name, tcp)

    def _saved(self) -> dict[str, Pose]:
        try:
            return dict(self._page.station.tools.content)
        except FileError as error:
            self._page.show_error(str(error))
            return {}

    def _add_row(self, name: str, tcp: Sequence[float]) -> None:
        with ui.element("div").classes("tcp-row") as row:
            button = ui.element("button").classes("tcp-pick").props("type=button")
            button.on("click", lambda: self._edit(name, tcp))
            with button:
                ui.label(name)
                ui.label(", ".join(f"{_MM * value:.1f}" for value in tcp[:3]) + " mm").classes("soft")
            self._page.needs_robot(ui.button("Use", on_click=lambda: self._apply(lambda: tcp))).props(
                "flat dense no-caps"
            )
            if name != _FLANGE:
                forget = self._page.handler(lambda: self._page.station.tools.delete(name))
                delete = ui.button(icon="delete", on_click=forget).props("flat dense round")
                delete.props["aria-label"] = f"Delete {name}"
        row.props["data-testid"] = f"tcp {name}"

    def _edit(self, name: str, tcp: Sequence[float]) -> None:
        self._name.set_value("" if name == _FLANGE else name)
        self._show(tcp)


def _element_text(index: int) -> Callable[[Station], str]:
    def read(station: Station) -> str:
        tcp = active_tcp(station)
        if tcp is None:
            return "-"
        return f"{_MM * tcp[index] + 0.0:.2f} mm" if index < 3 else f"{tcp[index] + 0.0:.4f} rad"

    return read


def _saved_name(station: Station) -> Any:
    """The name under which the active TCP was saved."""
    tcp = active_tcp(station)
    if tcp is None:
        return "-"
    if same_tcp(tcp, (0.0,) * 6):
        return _FLANGE
    loaded = station.tools.loaded
    return next((name for name, saved in loaded.items() if same_tcp(tcp, saved)), "one that is not saved here")
