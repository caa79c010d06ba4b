"""Initialize: power and brakes, what the safety system says, payload, and the state of every joint."""

from nicegui import ui

from client import dashboard
from client.operations import Operation
from client.pendant.page import Page
from client.pendant.screens.initialize_joints import joints_panel
from client.pendant.screens.initialize_payload import payload_panel
from client.pendant.screens.initialize_safety import safety_panel
from client.pendant.situation import STAGES, Action

__all__ = ["build"]


def build(page: Page) -> None:
    """Put it on the page."""
    with ui.element("div").classes("initialize"):
        _power_panel(page)
        safety_panel(page)
        joints_panel(page)
        payload_panel(page)


def _power_panel(page: Page) -> None:
    live = page.live
    with page.panel("Robot", "init-power"), ui.element("div").classes("init-power-row"):
        with ui.element("div").classes("init-status"):
            lamp = ui.element("div").classes("lamp init-lamp").props("data-testid=robot-lamp")
            live.bind(lamp, "state", lambda station: station.situation.tone)
            with ui.element("div").classes("init-status-text"):
                live.text(lambda station: station.situation.title, "init-mode").props("data-testid=robot-mode")
                live.text(lambda station: station.situation.hint, "init-hint").props("data-testid=robot-hint")
        with ui.element("div").classes("init-stages"):
            for number, name in enumerate(STAGES):
                _stage(page, number, name)
        with ui.element("div").classes("init-buttons"):
            _button(page, "On", "power", dashboard.POWER_ON, "power-on", Action.POWER_ON)
            _button(page, "Start", "lock_open", dashboard.BRAKE_RELEASE, "brake-release", Action.RELEASE_BRAKES)
            _button(page, "Off", "power_settings_new", dashboard.POWER_OFF, "power-off", Action.POWER_OFF)


def _stage(page: Page, number: int, name: str) -> None:
    with ui.element("div").classes("init-stage") as box:
        ui.element("span").classes("init-stage-dot")
        ui.label(name).classes("init-stage-name")
    page.live.bind(box, "state", lambda station: _progress(station.situation.stage, number))


def _progress(now: int, number: int) -> str:
    return "now" if number == now else "done" if number < now else "next"


def _button(page: Page, text: str, icon: str, operation: Operation[None], mark: str, action: Action) -> None:
    button = ui.button(text, icon=icon)
    button.props(f"unelevated stack size=lg data-testid={mark}").classes(f"init-button {mark}")
    page.button_for(action, lambda: page.station.ask(operation), button)
