"""The frame around the screens: what the robot is and does on top, program and speed below."""

from typing import TypeAlias

from nicegui import ui

from client import dashboard
from client.pendant.page import Page
from client.pendant.popups import show_dialogues
from client.pendant.screens import SCREENS, Screen
from client.pendant.station import Station
from urproto.modes import RobotMode, RuntimeState, SafetyMode

__all__ = ["build"]

_Unbuilt: TypeAlias = dict[str, tuple[Screen, ui.tab_panel]]

_GOOD_SAFETY = (SafetyMode.NORMAL, SafetyMode.REDUCED)


def build(page: Page, first: str) -> None:
    """The whole page, with one screen in view."""
    tabs = _header(page, first)
    _lost(page)
    with ui.tab_panels(tabs, value=first, animated=False).classes("screens") as panels:
        unbuilt = {screen.name: (screen, ui.tab_panel(screen.name).classes("screen")) for screen in SCREENS}
    _show(page, unbuilt, first)
    panels.on_value_change(lambda change: _change(page, unbuilt, change.value))
    _footer(page, tabs)
    show_dialogues(page)


def _header(page: Page, first: str) -> ui.tabs:
    with ui.header().classes("frame"):
        with ui.tabs().props("dense no-caps inline-label").classes("tabs") as tabs:
            for screen in SCREENS:
                tab = ui.tab(screen.name, screen.title, screen.icon).props(f"data-testid=tab-{screen.name}")
                if screen.only_emulated:
                    page.show_if(tab, lambda station: station.behind.available or station.behind.locked)
        tabs.set_value(first)
        ui.space()
        page.live.text(_robot, "robot-name")
        dark = ui.dark_mode(None)
        ui.button(icon="contrast", on_click=lambda: dark.set_value(not dark.value)).props(
            "flat round dense color=white"
        )
    return tabs


def _change(page: Page, unbuilt: _Unbuilt, name: str) -> None:
    _show(page, unbuilt, name)
    ui.run_javascript(f"history.replaceState(null, '', '/{name}')")


def _show(page: Page, unbuilt: _Unbuilt, name: str) -> None:
    """A screen is built when somebody wants to see it first: most pages are there for one or two."""
    if name in unbuilt:
        screen, panel = unbuilt.pop(name)
        page.live.building = name
        with panel:
            screen.build(page)
        page.live.building = None
    page.live.show(name)


def _robot(station: Station) -> str:
    model = station.model
    return f"{model.title if model else 'robot'} · PolyScope {station.version or '?'} · {station.robot_ip}"


def _lost(page: Page) -> None:
    with ui.element("div").classes("lost") as banner:
        ui.icon("link_off")
        page.live.text(lambda station: f"The robot at {station.robot_ip} does not answer: {station.trouble}")
    page.live.bind(banner, "state", lambda station: "ok" if station.connected else "lost")


def _footer(page: Page, tabs: ui.tabs) -> None:
    live, station = page.live, page.station
    with ui.footer().classes("frame"):
        with ui.button(on_click=lambda: tabs.set_value("initialize")).props("flat no-caps color=white") as status:
            lamp = ui.element("span").classes("lamp")
            live.text(lambda s: mode_text(s.robot_mode))
        status.props("data-testid=status")
        live.bind(lamp, "state", _lamp)
        chip = live.text(lambda s: s.safety_mode.name.replace("_", " ").lower(), "chip")
        live.bind(chip, "state", lambda s: "good" if s.safety_mode in _GOOD_SAFETY else "bad")
        live.text(lambda s: s.behind.pace, "chip pace").props("data-testid=pace")
        ui.space()
        live.text(lambda s: s.runtime_state.name.lower(), "program-state")
        _round("play_arrow", "play", page.doing(page.play))
        _round("pause", "pause", page.doing(lambda: station.ask(dashboard.PAUSE)))
        _round("stop", "stop", page.doing(lambda: station.ask(dashboard.STOP)))
        ui.space()
        _speed_slider(page)


def _round(icon: str, mark: str, click: object) -> None:
    ui.button(icon=icon, on_click=click).props("round dense unelevated color=primary").props(f"data-testid={mark}")  # type: ignore[arg-type]


def _speed_slider(page: Page) -> None:
    """Follows the robot, but for a moment after it was touched here."""
    station = page.station
    ui.icon("speed").classes("text-white")
    slider = (
        ui.slider(min=0, max=100, step=1)
        .props("label dense color=white")
        .classes("speed-slider")
        .props("data-testid=speed")
    )

    async def move() -> None:
        fraction = slider.value / 100.0
        await page.attempt(lambda: station.set_speed_slider(fraction))

    slider.on("change", move)
    page.live.effect(_percent, slider.set_value)
    page.live.text(lambda s: f"{_percent(s)} %", "speed-text")


def _percent(station: Station) -> int:
    fraction: float = station.values.get("target_speed_fraction", 1.0)
    return round(100 * fraction)


def mode_text(mode: RobotMode) -> str:
    """A robot mode for people, as PolyScope says it."""
    return _MODE_TEXTS.get(mode, mode.name.replace("_", " ").capitalize())


_MODE_TEXTS = {
    RobotMode.NO_CONTROLLER: "No controller",
    RobotMode.DISCONNECTED: "Disconnected",
    RobotMode.POWER_OFF: "Power off",
    RobotMode.POWER_ON: "Powering on",
    RobotMode.BOOTING: "Booting",
    RobotMode.IDLE: "Idle",
    RobotMode.BACKDRIVE: "Backdrive",
    RobotMode.RUNNING: "Normal",
}


def _lamp(station: Station) -> str:
    if not station.connected or station.safety_mode not in _GOOD_SAFETY:
        return "red"
    mode = station.robot_mode
    if mode is RobotMode.RUNNING:
        return "blue" if station.runtime_state is RuntimeState.PLAYING else "green"
    return "yellow" if mode in (RobotMode.IDLE, RobotMode.POWER_ON, RobotMode.BOOTING) else "red"
