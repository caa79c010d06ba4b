"""Simulation: functions of an emulator that a robot does not have."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import log10
from typing import Any, Final

from nicegui import ui

from client.pendant.page import Page
from client.pendant.screens import io
from client.pendant.screens.simulation_arm import arm_tab
from client.pendant.screens.simulation_faults import JOINTS, faults_tab
from client.pendant.screens.simulation_world import scene_panel, world_tab
from client.pendant.station import Station
from urproto.signals import DIGITAL_GROUPS

_DEVICES: Final[dict[str, tuple[str, str]]] = {
    "emergency_stop": ("Emergency stop", "robot's button, pressed"),
    "system_emergency_stop": ("System emergency stop", "another machine's, pressed"),
    "safeguard": ("Safeguard", "open"),
    "automatic_safeguard": ("Automatic mode safeguard", "open; effective in automatic mode"),
    "enabling_device": ("Enabling device", "not held halfway; effective in manual mode"),
    "reduced_mode": ("Reduced mode", "asked for"),
}
_BUTTONS: Final = {"emergency_stop": "robot", "system_emergency_stop": "system"}
_STEPS: Final = (1, 10, 125)


def inputs_tab(page: Page) -> None:
    """Add the tab to the page: the inputs as on the screen I/O."""
    with ui.element("div").classes("sim-stack") as box:
        box.props("data-state=simulated")
        for group in DIGITAL_GROUPS:
            ui.label(f"{group.name.capitalize()} inputs").classes("panel-title")
            io.inputs(page, group)
        ui.label("Analog inputs").classes("panel-title")
        for signal in io.ANALOG_INPUTS:
            io.analog_input(page, signal)


def safety_tab(page: Page) -> None:
    with ui.element("div").classes("sim-stack"):
        ui.label("Devices").classes("panel-title")
        with ui.element("div").classes("sim-devices"):
            for name in _DEVICES:
                _device_button(page, name)
        with ui.element("div").classes("sim-row"):
            _action_button(page, "Reset safeguard", "reset_safeguard")
            _action_button(page, "Restart safety", "restart_safety")
            _action_button(page, "Unlock at once", "unlock_protective_stop")
        ui.label("Causes").classes("panel-title")
        _cause_form(page)
        ui.label("Arm supply").classes("panel-title")
        with ui.element("div").classes("sim-row"):
            _action_button(page, "Switch the 48 V off", "set_arm_supply", present=False)
            _action_button(page, "Give them back", "set_arm_supply", present=True)
        ui.label("Last stop").classes("panel-title")
        page.live.text(_last_stop, "sim-text").props("data-testid=last-stop")


def _device_button(page: Page, name: str) -> None:
    title, active_text = _DEVICES[name]
    emulator = page.station.emulator

    def active(station: Station) -> bool:
        return bool((station.emulator.read("safety_devices") or {}).get(name, False))

    async def toggle() -> None:
        activate = not active(page.station)
        if name in _BUTTONS:
            verb = "press_emergency_stop" if activate else "release_emergency_stop"
            await emulator.change(verb, button=_BUTTONS[name])
        else:
            await emulator.change("set_safety_device", device=name, active=activate)

    with ui.element("button").classes("sim-device").props(f"type=button data-testid=device-{name}") as button:
        ui.element("span").classes("sim-bit-lamp")
        with ui.element("span").classes("sim-device-text"):
            ui.label(title)
            ui.label(active_text).classes("init-hint")
    button.on("click", page.handler(toggle))
    page.live.bind(button, "state", lambda station: "alarm" if active(station) else "off")


def _action_button(page: Page, text: str, verb: str, **arguments: Any) -> None:
    click = page.handler(partial(page.station.emulator.change, verb, **arguments))
    ui.button(text, on_click=click).props(f"outline no-caps data-testid={verb}").classes("sim-button")


def _cause_form(page: Page) -> None:
    with ui.element("div").classes("sim-row"):
        choice = ui.select({}, label="Cause", with_input=True)
        choice.props("outlined dense options-dense data-testid=cause").classes("sim-grow")
        joint = ui.select({None: "–", **JOINTS}, label="Joint", value=None).props("outlined dense options-dense")
        joint.classes("sim-joint-choice")

        async def trip() -> None:
            if not choice.value:
                raise ValueError("Choose a cause first.")
            arguments = {} if joint.value is None else {"joint": joint.value}
            await page.station.emulator.change("trip_safety", cause=choice.value, **arguments)

        button = ui.button("Trip", icon="report", on_click=page.handler(trip))
        button.props("unelevated color=negative data-testid=trip").classes("sim-button")

    def set_catalogue(catalogue: Mapping[str, Any]) -> None:
        causes = catalogue.get("safety_causes", {})
        options = {name: f"{name.replace('_', ' ')} – {text}" for name, text in causes.items()}
        choice.set_options(options, value=next(iter(options), None))

    page.live.effect(lambda station: station.emulator.catalogue, set_catalogue)


def _last_stop(station: Station) -> str:
    stop = station.emulator.read("last_stop")
    if stop is None:
        return "None since the emulator started."
    verb = "took" if stop["over"] else "has taken"
    return (
        f"{stop['mode'].replace('_', ' ').capitalize()}, stop category {stop['category']}: {verb} "
        f"{stop['duration_s']:.3f} s, the tool travelled {1e3 * stop['distance_m']:.0f} mm."
    )


def connections_tab(page: Page) -> None:
    with ui.element("div").classes("sim-rows sim-connections").props("data-testid=connections") as rows:
        rows.props('tabindex=0 role=region aria-label="Connections"')

    def show(connections: Mapping[str, Sequence[str]] | None) -> None:
        rows.clear()
        with rows:
            for title in ("Port", "", "Clients"):
                ui.label(title).classes("init-th")
            for name, peers in (connections or {}).items():
                _connection_row(page, name, peers)

    page.live.effect(lambda station: station.emulator.read("connections"), show)


def _connection_row(page: Page, name: str, peers: Sequence[str]) -> None:
    emulator = page.station.emulator
    ui.label(name).classes("sim-port")
    ui.label(str(emulator.catalogue.get("ports", {}).get(name, ""))).classes("sim-port-number")
    with ui.element("div").classes("sim-peers"):
        for peer in peers:
            with ui.element("span").classes("sim-peer"):
                ui.label(peer)
                if name != "control":
                    drop = partial(emulator.change, "inject_fault", kind="drop_connection", port=name, peer=peer)
                    ui.button(icon="link_off", on_click=page.handler(drop)).props(
                        f'flat round dense size=sm aria-label="Drop {peer}" title="End this connection"'
                    )
        if not peers:
            ui.label("–").classes("init-th")


_SLOWEST, _FASTEST = 0.1, 10.0


def time_panel(page: Page) -> None:
    """One line: the clock, pause or resume, steps, and a slider of speeds."""
    live, emulator = page.live, page.station.emulator
    with ui.card().classes("panel sim-time"):
        ui.icon("schedule").classes("sim-time-icon")
        live.text(_clock, "sim-clock").props("data-testid=sim-clock")
        live.bind(
            live.text(lambda s: s.emulator.pace or "real time", "sim-pace").props("data-testid=sim-pace"),
            "state",
            _pace_state,
        )
        pause = ui.button("Pause", icon="pause", on_click=page.handler(lambda: emulator.change("pause_time")))
        pause.props("unelevated dense data-testid=time-pause").classes("sim-button")
        resume = ui.button("Resume", icon="play_arrow", on_click=page.handler(lambda: emulator.change("resume_time")))
        resume.props("unelevated dense color=positive data-testid=time-resume").classes("sim-button")
        page.show_if(pause, lambda station: not _paused(station))
        page.show_if(resume, _paused)
        with ui.button_group().props("flat").classes("sim-steps"):
            for count in _STEPS:
                _step_button(page, count)
        ui.space()
        _speed_slider(page)


def _step_button(page: Page, count: int) -> None:
    button = ui.button(f"+{count}", on_click=page.handler(lambda: page.station.emulator.change("step", periods=count)))
    button.props(f"outline dense data-testid=time-step-{count}").classes("sim-button")
    button.tooltip(f"{count} control period{'s' if count > 1 else ''}")
    page.live.effect(_paused, button.set_enabled)


def _speed_slider(page: Page) -> None:
    emulator = page.station.emulator
    slider = ui.slider(min=log10(_SLOWEST), max=log10(_FASTEST), step=0.01).props("dense data-testid=time-speed")
    slider.classes("sim-speed").props('markers=1 aria-label="Speed of time"')

    slider.on("change", page.handler(lambda: emulator.change("set_speed", speed=round(10.0**slider.value, 2))))
    live = page.live
    live.effect(_current_speed, lambda speed: slider.set_value(log10(min(_FASTEST, max(_SLOWEST, speed or _FASTEST)))))
    for text, speed, test_id in (
        ("0.1×", 0.1, "slow"),
        ("1×", 1.0, "real"),
        ("10×", 10.0, "fast"),
        ("Max", 0.0, "max"),
    ):
        button = ui.button(text, on_click=page.handler(partial(emulator.change, "set_speed", speed=speed)))
        button.props(f"flat dense no-caps data-testid=time-{test_id}").classes("sim-button")
        if not speed:
            button.tooltip("As fast as possible")


def _paused(station: Station) -> bool:
    return bool(station.emulator.time.get("paused", False))


def _current_speed(station: Station) -> float:
    return float(station.emulator.time.get("speed", 1.0))


def _pace_state(station: Station) -> str:
    return "paused" if _paused(station) else "real" if _current_speed(station) == 1.0 else "other"


def _clock(station: Station) -> str:
    time = station.emulator.time
    paused = _paused(station) or not station.connected
    seconds = float(time.get("time_s", 0.0) if paused else station.values.get("timestamp", 0.0))
    return f"{seconds:.3f} s" if paused else f"{seconds:.1f} s"


_TABS: Final[tuple[tuple[str, str, Callable[[Page], None]], ...]] = (
    ("faults", "Faults", faults_tab),
    ("world", "World", world_tab),
    ("inputs", "Inputs", inputs_tab),
    ("safety", "Safety", safety_tab),
    ("arm", "Arm and state", arm_tab),
    ("connections", "Connections", connections_tab),
)


def build(page: Page) -> None:
    with ui.element("div").classes("simulation-absent") as absent_panel:
        page.live.text(_absence_reason).props("data-testid=simulation-absent")
    with ui.element("div").classes("simulation") as present_panel:
        time_panel(page)
        scene_panel(page)
        with ui.card().classes("panel sim-tools"):
            _tools(page)
    page.show_if(present_panel, lambda station: station.emulator.available)
    page.show_if(absent_panel, lambda station: not station.emulator.available)


def _tools(page: Page) -> None:
    with ui.tabs().props("dense no-caps align=justify").classes("sim-tabs") as tabs:
        for name, title, _ in _TABS:
            ui.tab(name, title).props(f"data-testid=sim-{name}")
    with ui.tab_panels(tabs, value=_TABS[0][0], animated=False).classes("sim-panels") as panels:
        unbuilt = {name: (build_tab, ui.tab_panel(name).classes("sim-panel")) for name, _, build_tab in _TABS}
    screen = page.live.building

    def show(name: str) -> None:
        """Show a tab. It is built when it is first shown."""
        if name in unbuilt:
            build_tab, panel = unbuilt.pop(name)
            page.live.building = screen
            with panel:
                build_tab(page)
            page.live.building = None

    show(_TABS[0][0])
    page.live.building = screen
    panels.on_value_change(lambda change: show(change.value))


def _absence_reason(station: Station) -> str:
    if station.emulator.available:
        return ""
    if not station.connected:
        return f"{station.situation.title}. {station.situation.hint}"
    if station.emulator.locked:
        return (
            "There is an emulator, and its control API asks for a token. Start the pendant with --control-token, or "
            "with UR_EMULATOR_TOKEN in its environment."
        )
    return "There is no control API: this is a robot, or an emulator that was started without one."
