"""The general purpose registers of the robot's Modbus server, 128 to 255."""

from collections.abc import Callable
from typing import Any

from nicegui import ui

from client.modbus import GENERAL_REGISTERS
from client.pendant.page import Page
from client.pendant.screens.io_registers import ask_number
from client.pendant.station import Station
from client.pendant.views import Views

__all__ = ["build"]

_FORMS: dict[str, Callable[[int], str]] = {
    "unsigned": str,
    "signed": lambda word: str(word - 0x10000 if word & 0x8000 else word),
    "hex": lambda word: f"{word:04X}",
}


def build(page: Page, views: Views) -> None:
    """Put it on the page."""
    registers = page.station.port_registers
    form = ["unsigned"]
    looking = [False]

    def look(view: str) -> None:
        wanted = view == "modbus"
        if wanted != looking[0]:
            looking[0] = wanted
            (registers.look if wanted else registers.leave)()

    views.on_look.append(look)

    async def touch(index: int) -> None:
        address = GENERAL_REGISTERS[index]
        now = registers.words[index] if registers.words else None
        value = await ask_number(page, f"Modbus register {address}", now, whole=True)
        if value is not None:
            await page.attempt(lambda: registers.write(address, word_of(value)))

    with ui.row().classes("register-choice"):
        ui.toggle(
            {"unsigned": "Unsigned", "signed": "Signed", "hex": "Hexadecimal"},
            value=form[0],
            on_change=lambda change: form.__setitem__(0, change.value),
        ).props("no-caps unelevated data-testid=modbus-form")
        page.live.text(lambda station: station.port_registers.trouble or _where(station), "soft")
    title = "General purpose registers: touch one to write it"
    with page.panel(title, "register-panel"), ui.element("div").classes("cells modbus-cells") as grid:
        for index, address in enumerate(GENERAL_REGISTERS):
            cell = ui.element("button").classes("cell").props(f"data-testid=modbus-{address} type=button")
            cell.on("click", lambda _, index=index: touch(index))
            with cell:
                ui.element("i")
                ui.label("")
    page.live.bind(grid, "cells", lambda station: _cells(station, form[0]))


def _where(station: Station) -> str:
    return f"Modbus/TCP server at {station.robot_ip}:{station.ports['modbus']}"


def _cells(station: Station, form: str) -> Any:
    words = station.port_registers.words or ("-",) * len(GENERAL_REGISTERS)
    write = _FORMS[form]
    return [GENERAL_REGISTERS[0], [word if isinstance(word, str) else write(word) for word in words]]


def word_of(value: float) -> int:
    """A register's 16 bits for a number from -32768 to 65535. Raises ValueError."""
    if value != int(value) or not -0x8000 <= value <= 0xFFFF:
        raise ValueError(f"a Modbus register cannot hold {value:g}: it has whole numbers from -32768 to 65535")
    return int(value) & 0xFFFF
