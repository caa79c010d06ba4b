"""The frame around the screens: the state of the robot at the top, program and speed at the bottom."""

from typing import Final, TypeAlias

from nicegui import ui

from client.pendant.page import Page
from client.pendant.popups import show_dialogues
from client.pendant.screens import SCREENS, Screen
from client.pendant.station import Station

_REAL_HINT: Final = "In simulation, programs move the arm on the screens; the real arm stands still."
_EMULATED_HINT: Final = (
    "There is no real arm: the emulator plays its part. In simulation, programs move the arm on the screens and on all "
    "ports, while the emulated arm stands still."
)

_Unbuilt: TypeAlias = dict[str, tuple[Screen, ui.tab_panel]]


def build(page: Page, initial_screen: str) -> None:
    tabs = _header(page, initial_screen)
    _lost_banner(page)
    with ui.tab_panels(tabs, value=initial_screen, animated=False).classes("screens") as panels:
        unbuilt = {screen.name: (screen, ui.tab_panel(screen.name).classes("screen")) for screen in SCREENS}
    _show_screen(page, unbuilt, initial_screen)
    panels.on_value_change(lambda change: _on_tab_change(page, unbuilt, change.value))
    _footer(page, tabs)
    show_dialogues(page)
    page.live.effect(_tab_title, lambda title: _set_tab_title(page, title))


def _header(page: Page, initial_screen: str) -> ui.tabs:
    with ui.header().classes("frame"):
        with ui.tabs().props("dense no-caps inline-label").classes("tabs") as tabs:
            for screen in SCREENS:
                tab = ui.tab(screen.name, screen.title, screen.icon).props(f"data-testid=tab-{screen.name}")
                page.show_if(tab, screen.shown)
        tabs.set_value(initial_screen)
        ui.space()
        page.live.text(_robot_title, "robot-name")
        dark = ui.dark_mode(None)
        ui.button(icon="contrast", on_click=lambda: dark.set_value(not dark.value)).props(
            'flat round dense color=white aria-label="Dark or light"'
        ).tooltip("Dark or light")
    return tabs


def _on_tab_change(page: Page, unbuilt: _Unbuilt, name: str) -> None:
    _show_screen(page, unbuilt, name)
    ui.run_javascript(f"history.replaceState(null, '', '/{name}')")


def _show_screen(page: Page, unbuilt: _Unbuilt, name: str) -> None:
    """Show a screen. It is built when it is first shown, because most pages show only one or two."""
    if name in unbuilt:
        screen, panel = unbuilt.pop(name)
        page.live.building = name
        with panel:
            screen.build(page)
        page.live.building = None
    page.live.show(name)


def _robot_title(station: Station) -> str:
    model = station.model
    return f"{model.title if model else 'robot'} · PolyScope {station.version or '?'} · {station.robot_ip}"


def _tab_title(station: Station) -> str:
    """The title of the browser's tab, which may be one of many."""
    return f"{station.model.title if station.model else 'Pendant'} · {station.robot_ip}"


def _set_tab_title(page: Page, title: str) -> None:
    with page.content:
        ui.page_title(title)


def _lost_banner(page: Page) -> None:
    with ui.element("div").classes("lost") as banner:
        ui.icon("link_off")
        page.live.text(lambda station: f"The robot at {station.robot_ip} does not answer: {station.problem}")
    page.live.bind(banner, "state", lambda station: "ok" if station.connected else "lost")
    with ui.element("div").classes("old").props("data-testid=old"):
        ui.icon("history")
        ui.element("span")  # its text is from pendant.js, since this process is the one that does not answer


def _footer(page: Page, tabs: ui.tabs) -> None:
    live = page.live
    with ui.footer().classes("frame"):
        with ui.button(on_click=lambda: tabs.set_value("initialize")).props("flat no-caps color=white") as status:
            lamp = ui.element("span").classes("lamp")
            live.text(lambda s: s.situation.title)
        status.props('data-testid=status aria-label="State of the arm: see Initialize"')
        live.bind(lamp, "state", lambda s: s.situation.tone)
        _simulation_switch(page)
        live.text(lambda s: s.emulator.pace, "chip pace").props("data-testid=pace")
        ui.space()
        live.text(lambda s: s.situation.program, "program-state").props("data-testid=program-state")
        page.program_buttons("dense color=primary", "")
        ui.space()
        _speed_slider(page)


def _simulation_switch(page: Page) -> None:
    """A switch as in PolyScope's footer. If it cannot be used from here, it is shown only in simulation."""
    with ui.button(on_click=page.handler(page.switch_simulation), color=None).props(
        "dense no-caps unelevated"
    ) as switch:
        page.live.text(_simulation_text)
    switch.classes("chip simulation-switch").props("data-testid=simulation-switch")
    page.live.bind(switch, "title", lambda s: _EMULATED_HINT if s.emulator.available else _REAL_HINT)
    page.live.effect(lambda s: s.simulating, lambda on: switch.props(f"aria-pressed={'true' if on else 'false'}"))
    page.live.effect(lambda s: s.can_simulate, switch.set_enabled)
    page.show_if(switch, lambda s: s.can_simulate or s.simulating)


def _simulation_text(station: Station) -> str:
    return (
        "Simulation" if station.simulating else "Real robot (emulated)" if station.emulator.available else "Real robot"
    )


def _speed_slider(page: Page) -> None:
    """A slider that follows the robot, except for a moment after it was moved here."""
    station = page.station
    ui.icon("speed").classes("text-white")
    slider = (
        ui.slider(min=0, max=100, step=1)
        .props('label dense color=white aria-label="Speed slider"')
        .classes("speed-slider")
        .props("data-testid=speed")
    )

    async def set_speed() -> None:
        fraction = slider.value / 100.0
        await page.attempt(lambda: station.set_speed_slider(fraction))

    slider.on("change", set_speed)
    page.live.effect(_speed_percent, lambda percent: slider.set_value(percent or 0))
    page.live.effect(lambda s: s.connected, slider.set_enabled)
    page.live.text(lambda s: "–" if _speed_percent(s) is None else f"{_speed_percent(s)} %", "speed-text")


def _speed_percent(station: Station) -> int | None:
    fraction: float | None = station.values.get("target_speed_fraction")
    return None if fraction is None else round(100 * fraction)
