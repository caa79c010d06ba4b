"""Initialize."""

from nicegui import ui

from client import dashboard
from client.pendant.page import Page

__all__ = ["build"]


def build(page: Page) -> None:
    """Put it on the page."""
    station = page.station
    with page.panel("Robot"), ui.row():
        ui.button("On", on_click=page.doing(lambda: station.ask(dashboard.POWER_ON))).props("data-testid=power-on")
        ui.button("Start", on_click=page.doing(lambda: station.ask(dashboard.BRAKE_RELEASE))).props(
            "data-testid=brake-release"
        )
        ui.button("Off", on_click=page.doing(lambda: station.ask(dashboard.POWER_OFF))).props("data-testid=power-off")
