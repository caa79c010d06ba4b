"""Simulation: what an emulator can be made to do and a robot cannot."""

from collections.abc import Callable
from typing import Final

from nicegui import ui

from client.pendant.page import Page
from client.pendant.screens.simulation_arm import arm_tab
from client.pendant.screens.simulation_connections import connections_tab
from client.pendant.screens.simulation_faults import faults_tab
from client.pendant.screens.simulation_inputs import inputs_tab
from client.pendant.screens.simulation_safety import safety_tab
from client.pendant.screens.simulation_scene import scene_panel
from client.pendant.screens.simulation_time import time_panel
from client.pendant.screens.simulation_world import world_tab
from client.pendant.station import Station

__all__ = ["build"]

_TABS: Final[tuple[tuple[str, str, Callable[[Page], None]], ...]] = (
    ("faults", "Faults", faults_tab),
    ("world", "World", world_tab),
    ("inputs", "Inputs", inputs_tab),
    ("safety", "Safety", safety_tab),
    ("arm", "Arm and state", arm_tab),
    ("connections", "Connections", connections_tab),
)


def build(page: Page) -> None:
    """Put it on the page."""
    with ui.element("div").classes("simulation-absent") as absent:
        page.live.text(_why_absent).props("data-testid=simulation-absent")
    with ui.element("div").classes("simulation") as present:
        time_panel(page)
        scene_panel(page)
        with ui.card().classes("panel sim-tools"):
            _tools(page)
    page.show_if(present, lambda station: station.behind.available)
    page.show_if(absent, lambda station: not station.behind.available)


def _tools(page: Page) -> None:
    with ui.tabs().props("dense no-caps align=justify").classes("sim-tabs") as tabs:
        for name, title, _ in _TABS:
            ui.tab(name, title).props(f"data-testid=sim-{name}")
    with ui.tab_panels(tabs, value=_TABS[0][0], animated=False).classes("sim-panels") as panels:
        unbuilt = {name: (put, ui.tab_panel(name).classes("sim-panel")) for name, _, put in _TABS}
    screen = page.live.building

    def show(name: str) -> None:
        """A tab is built when somebody wants to see it first."""
        if name in unbuilt:
            put, panel = unbuilt.pop(name)
            page.live.building = screen
            with panel:
                put(page)
            page.live.building = None

    show(_TABS[0][0])
    page.live.building = screen
    panels.on_value_change(lambda change: show(change.value))


def _why_absent(station: Station) -> str:
    if station.behind.available:
        return ""
    if not station.connected:
        return f"{station.situation.title}. {station.situation.hint}"
    if station.behind.locked:
        return (
            "There is an emulator, and its control API asks for a token. Start the pendant with --control-token, or "
            "with UR_EMULATOR_TOKEN in its environment."
        )
    return "There is no control API: this is a robot, or an emulator that was started without one."
