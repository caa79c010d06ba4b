"""Installation: tool, load, mounting, External Control; what the arm is."""

from nicegui import ui

from client.pendant.page import Page
from client.pendant.screens import installation_arm, installation_driver, installation_mounting, installation_tcp
from client.pendant.views import Views

__all__ = ["build"]


def build(page: Page) -> None:
    """Put it on the page."""
    titles = {"settings": "Settings", "arm": "Robot"}
    with ui.column().classes("io"), Views(page, "installation", titles) as views:
        with views.view("settings", "installation-tool"):
            installation_tcp.build(page)
            with ui.column().classes("installation-column"):
                installation_mounting.build_payload(page)
                installation_mounting.build_mounting(page)
                installation_driver.build(page, views)
        with views.view("arm", "installation-arm"):
            installation_arm.build(page, views)
