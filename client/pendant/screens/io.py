"""I/O: digital signals as lamps that switch, analog signals, the tool; registers and the Modbus server beside them."""

from nicegui import ui

from client.pendant.page import Page
from client.pendant.screens import io_analog, io_digital, io_modbus, io_registers, io_tool
from client.pendant.views import Views

__all__ = ["build"]


def build(page: Page) -> None:
    """Put it on the page."""
    titles = {"signals": "Robot", "registers": "Registers", "modbus": "Modbus"}
    with ui.column().classes("io"), Views(page, "io", titles) as views:
        with views.view("signals", "io-signals"):
            io_digital.build(page)
            io_analog.build(page)
            io_tool.build(page)
            io_tool.power(page)
        with views.view("registers"):
            io_registers.build(page, views)
        with views.view("modbus"):
            io_modbus.build(page, views)
