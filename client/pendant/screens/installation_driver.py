"""External Control: where the robot asks a driver for its program."""

from typing import Any

from nicegui import ui

from client.driver.sender import SENDER_PORT
from client.pendant.page import Page
from client.pendant.station import Station
from client.pendant.views import Views

__all__ = ["build"]


def build(page: Page, views: Views) -> None:
    """Put it on the page: to be filled in on an emulator, explained on a robot."""
    with page.panel("External Control", "installation-panel driver-panel"):
        with ui.column().classes("gap-2") as emulated:
            _form(page, views)
        with ui.column().classes("gap-2") as real:
            _explanation(page)
        ui.label("A program with an External Control node asks there for what it is to do when it is played.").classes(
            "soft"
        )
    page.live.effect(_can_be_set, emulated.set_visibility)
    page.live.effect(lambda station: station.connected and not _can_be_set(station), real.set_visibility)


def _can_be_set(station: Station) -> bool:
    return station.behind.available and "set_external_control" in station.behind.verbs


def _form(page: Page, views: Views) -> None:
    behind = page.station.behind
    with ui.row().classes("items-center no-wrap"):
        host = ui.input("Host IP").props("dense outlined data-testid=driver-host")
        port = ui.number("Custom port", precision=0).props("dense outlined data-testid=driver-port")

    async def read() -> None:
        found: dict[str, Any] = await behind.call("external_control")
        host.set_value(found["host"])
        port.set_value(found["port"])

    async def save() -> None:
        if not host.value or port.value is None:
            raise ValueError("the address of a driver is a host and a port: fill in both")
        await behind.call("set_external_control", host=host.value, port=int(port.value))
        await read()

    with ui.row().classes("items-center"):
        ui.button("Save", on_click=page.doing(save, "Saved")).props("no-caps data-testid=driver-save")
        own = ui.button("This machine", on_click=lambda: host.set_value(page.station.own_address))
        own.props("flat no-caps data-testid=driver-here")
    page.live.effect(
        lambda station: _can_be_set(station) and views.looked_at == "settings",
        lambda looking: page.soon(read) if looking else None,
    )


def _explanation(page: Page) -> None:
    ui.label("On a robot this is set on its own teach pendant, below Installation, URCaps, External Control:")
    with ui.element("div").classes("facts"):
        ui.label("Host IP")
        page.live.text(lambda station: station.own_address or "no way from here to the robot")
        ui.label("Custom port")
        ui.label(str(SENDER_PORT))
    ui.label("when the driver runs on the machine that serves this page.").classes("soft")
