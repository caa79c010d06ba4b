"""Saved poses: go there, save the present one, rename, delete."""

from typing import Final

from nicegui import ui

from client.errors import FileError
from client.pendant.page import Page
from client.pendant.poses import BUILT_IN
from client.pendant.screens.move_settings import MoveSettings
from client.pendant.station import Station
from urproto.errors import RobotRefused
from urproto.robots import Joints

__all__ = ["saved_poses"]

_ICONS: Final = {"Home": "home", "Zero": "exposure_zero"}


def saved_poses(page: Page, settings: MoveSettings) -> None:
    """A list that all browsers share, and what adds to it."""
    listed = ui.element("div").classes("pose-list")

    def show(known: tuple[str, int] | None) -> None:
        listed.clear()
        if known is not None:
            with listed:
                for name, q_rad in BUILT_IN.items():
                    _row(page, settings, name, q_rad, own=False)
                for name, q_rad in _read(page, known[0]).items():
                    _row(page, settings, name, q_rad, own=True)

    page.live.effect(_known, show)
    with ui.row().classes("target-buttons"):
        box = ui.input(placeholder="Name of the present pose").props("dense outlined data-testid=pose-name")
        box.classes("pose-name")

        async def save() -> None:
            station = page.station
            q = station.values.get("actual_q")
            if q is None:
                raise RobotRefused("saving a pose", "the robot has not told where it is", "wait until it is connected")
            station.poses.save(_model(station), box.value or "", q)
            box.set_value("")

        ui.button("Save", icon="add", on_click=page.doing(save)).props("unelevated no-caps data-testid=pose-save")
        box.on("keydown.enter", page.doing(save))


def _known(station: Station) -> tuple[str, int] | None:
    """What the list depends on."""
    return None if station.model is None else (station.model.name, station.poses.version)


def _model(station: Station) -> str:
    if station.model is None:
        raise RobotRefused("saved poses", "it has not said which arm it is", "wait until it is connected")
    return station.model.name


def _read(page: Page, model: str) -> dict[str, Joints]:
    try:
        return page.station.poses.of(model)
    except FileError as error:
        page.complain(str(error))
        return {}


def _row(page: Page, settings: MoveSettings, name: str, q_rad: Joints, *, own: bool) -> None:
    async def go() -> None:
        await settings.move(lambda: page.station.mover.move_j(q_rad, f"Moving to {name}", **settings.joint_speed))

    with ui.element("div").classes("pose-row"):
        ui.icon("place" if own else _ICONS.get(name, "place"))
        ui.label(name).classes("pose-title")
        if own:
            _menu(page, name)
        button = ui.button("Go", icon="near_me", on_click=page.doing(go)).props("flat no-caps dense")
        button.props["data-testid"] = f"go-{name}"


def _menu(page: Page, name: str) -> None:
    station = page.station
    with ui.button(icon="more_vert").props('flat dense round aria-label="Rename or delete"') as button, ui.menu():
        ui.menu_item("Rename…", lambda: _rename(page, name)).props("data-testid=pose-rename")

        async def delete() -> None:
            station.poses.delete(_model(station), name)

        ui.menu_item("Delete", page.doing(delete)).props("data-testid=pose-delete")
    button.props["data-testid"] = f"menu-{name}"


async def _rename(page: Page, name: str) -> None:
    station = page.station
    new = await _asked("Rename pose", name)
    if new is not None:

        async def rename() -> None:
            station.poses.rename(_model(station), name, new)

        await page.attempt(rename)


async def _asked(title: str, text: str) -> str | None:
    """What somebody types instead of a text; None if nothing."""
    with ui.dialog() as dialog, ui.card():
        ui.label(title).classes("text-h6")
        box = ui.input(value=text).props("autofocus outlined dense data-testid=pose-new-name")
        box.on("keydown.enter", lambda: dialog.submit(box.value))
        with ui.row().classes("w-full justify-end"):
            ui.button("Cancel", on_click=lambda: dialog.submit(None)).props("flat")
            ui.button("Rename", on_click=lambda: dialog.submit(box.value)).props("data-testid=pose-renamed")
    dialog.on("hide", dialog.delete)
    answer: str | None = await dialog
    return answer
