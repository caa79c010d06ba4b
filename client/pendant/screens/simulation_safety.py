"""Safety devices of an emulator, and every cause of a stop on demand."""

from collections.abc import Mapping
from functools import partial
from typing import Any, Final

from nicegui import ui

from client.pendant.fault_form import JOINTS
from client.pendant.page import Page
from client.pendant.station import Station

__all__ = ["safety_tab"]

_DEVICES: Final[dict[str, tuple[str, str]]] = {
    "emergency_stop": ("Emergency stop", "robot's button, pressed"),
    "system_emergency_stop": ("System emergency stop", "another machine's, pressed"),
    "safeguard": ("Safeguard", "open"),
    "automatic_safeguard": ("Automatic mode safeguard", "open; counts in automatic mode"),
    "enabling_device": ("Enabling device", "not held halfway; counts in manual mode"),
    "reduced_mode": ("Reduced mode", "asked for"),
}
_BUTTONS: Final = {"emergency_stop": "robot", "system_emergency_stop": "system"}


def safety_tab(page: Page) -> None:
    """Put it there."""
    with ui.element("div").classes("sim-stack"):
        ui.label("Devices").classes("panel-title")
        with ui.element("div").classes("sim-devices"):
            for name in _DEVICES:
                _device(page, name)
        with ui.element("div").classes("sim-row"):
            _action(page, "Reset safeguard", "reset_safeguard")
            _action(page, "Restart safety", "restart_safety")
            _action(page, "Unlock at once", "unlock_protective_stop")
        ui.label("Causes").classes("panel-title")
        _causes(page)
        ui.label("Arm supply").classes("panel-title")
        with ui.element("div").classes("sim-row"):
            _action(page, "Take the 48 V away", "set_arm_supply", present=False)
            _action(page, "Give them back", "set_arm_supply", present=True)
        ui.label("Last stop").classes("panel-title")
        page.live.text(_last_stop, "sim-text").props("data-testid=last-stop")


def _device(page: Page, name: str) -> None:
    title, active_text = _DEVICES[name]
    behind = page.station.behind

    def active(station: Station) -> bool:
        devices = station.behind.watch("safety_devices").value if station.behind.available else None
        return bool((devices or {}).get(name, False))

    async def toggle() -> None:
        wanted = not active(page.station)
        if name in _BUTTONS:
            verb = "press_emergency_stop" if wanted else "release_emergency_stop"
            await behind.change(verb, button=_BUTTONS[name])
        else:
            await behind.change("set_safety_device", device=name, active=wanted)

    with ui.element("button").classes("sim-device").props(f"type=button data-testid=device-{name}") as button:
        ui.element("span").classes("sim-bit-lamp")
        with ui.element("span").classes("sim-device-text"):
            ui.label(title)
            ui.label(active_text).classes("init-hint")
    button.on("click", page.doing(toggle))
    page.live.bind(button, "state", lambda station: "alarm" if active(station) else "off")


def _action(page: Page, text: str, verb: str, **arguments: Any) -> None:
    click = page.doing(partial(page.station.behind.change, verb, **arguments))
    ui.button(text, on_click=click).props(f"outline no-caps data-testid={verb}").classes("sim-button")


def _causes(page: Page) -> None:
    with ui.element("div").classes("sim-row"):
        choice = ui.select({}, label="Cause", with_input=True)
        choice.props("outlined dense options-dense data-testid=cause").classes("sim-grow")
        joint = ui.select({None: "–", **JOINTS}, label="Joint", value=None).props("outlined dense options-dense")
        joint.classes("sim-joint-choice")

        async def trip() -> None:
            if not choice.value:
                raise ValueError("Choose a cause first.")
            arguments = {} if joint.value is None else {"joint": joint.value}
            await page.station.behind.change("trip_safety", cause=choice.value, **arguments)

        button = ui.button("Trip", icon="report", on_click=page.doing(trip))
        button.props("unelevated color=negative data-testid=trip").classes("sim-button")

    def know(catalogue: Mapping[str, Any]) -> None:
        causes = catalogue.get("safety_causes", {})
        options = {name: f"{name.replace('_', ' ')} – {text}" for name, text in causes.items()}
        choice.set_options(options, value=next(iter(options), None))

    page.live.effect(lambda station: station.behind.catalogue, know)


def _last_stop(station: Station) -> str:
    stop = station.behind.watch("last_stop").value if station.behind.available else None
    if stop is None:
        return "None since the emulator began."
    how = "took" if stop["over"] else "has taken"
    return (
        f"{stop['mode'].replace('_', ' ').capitalize()}, stop category {stop['category']}: {how} "
        f"{stop['duration_s']:.3f} s, the tool travelled {1e3 * stop['distance_m']:.0f} mm."
    )
