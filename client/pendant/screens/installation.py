"""Installation: tool, payload, mounting, External Control, and data of the arm."""

import math
from typing import Any, Final

from nicegui import ui

from client.driver.script_sender import SENDER_PORT
from client.pendant.page import Page, Views
from client.pendant.screens import installation_arm, installation_settings, installation_tcp
from client.pendant.screens.payload import active_payload, payload_form
from client.pendant.settings import apply_gravity, tilt_of
from client.pendant.station import Station
from urscript.polyscope.installation_file import gravity_of

_PRESETS: Final = {"Floor": (0, 0), "Wall": (90, 0), "Ceiling": (180, 0)}  # degrees


def build_payload(page: Page) -> None:
    """The payload that the robot assumes: mass and centre of gravity."""
    with page.panel("Payload", "installation-panel"):
        page.live.text(_payload_text, "active-line").props("data-testid=payload-active")
        payload_form(page, "Use it", "payload-use")


def build_mounting(page: Page) -> None:
    """The mounting of the base: the direction of gravity."""
    with page.panel("Mounting", "installation-panel"):
        page.live.text(_mounting_text, "active-line").props("data-testid=mounting-active")
        presets = ui.row().classes("items-center")
        with ui.element("div").classes("six two"):
            tilt = _number_field("Tilt [°]", "mount-tilt")
            turn = _number_field("Turn of the base [°]", "mount-turn")
        with presets:
            for name, angles in _PRESETS.items():
                preset = ui.button(name, on_click=lambda _, angles=angles: _fill((tilt, turn), angles))
                preset.props(f"outline no-caps data-testid=mount-{name}")
        gravity = ui.label().classes("soft").props("data-testid=mount-gravity")

        def entered_gravity() -> tuple[float, float, float]:
            return gravity_of(math.radians(tilt.value or 0.0), math.radians(turn.value or 0.0))

        def show_gravity() -> None:
            gravity.set_text(
                "Gravity felt by the base: " + ", ".join(f"{value:.3f}" for value in entered_gravity()) + " m/s²"
            )

        async def apply() -> None:
            confirmed = await apply_gravity(page.station, entered_gravity())
            unconfirmed = "Mounting sent; this version does not report which one it uses"
            page.show_message("Mounting in use" if confirmed else unconfirmed)

        for box in (tilt, turn):
            box.on_value_change(show_gravity)
        show_gravity()
        with ui.row().classes("items-center"):
            page.needs_robot(ui.button("Use it", on_click=page.handler(apply))).props("no-caps data-testid=mount-use")
            gravity.move()
    page.live.effect(_current_tilt, lambda angles: _fill((tilt, turn), angles))


def _number_field(label: str, test_id: str) -> ui.number:
    return ui.number(label, value=0.0).props(f"dense outlined hide-bottom-space data-testid={test_id}")


def _fill(boxes: tuple[ui.number, ...], values: tuple[float, ...] | None) -> None:
    for box, value in zip(boxes, values or (), strict=False):
        box.set_value(value)


def _payload_text(station: Station) -> str:
    values = active_payload(station)
    if values is None:
        return "This version does not report its payload" if station.connected else "-"
    mass, x, y, z = values
    return f"In effect: {mass:.3f} kg at {x:.1f}, {y:.1f}, {z:.1f} mm"


def _mounting_text(station: Station) -> str:
    angles = _current_tilt(station)
    if angles is None:
        return "This version does not report its mounting" if station.connected else "-"
    return f"In effect: tilt {angles[0]:.1f}°, turn {angles[1]:.1f}°"


def _current_tilt(station: Station) -> tuple[float, float] | None:
    gravity = station.values.get("target_gravity")
    if gravity is None:
        return None
    tilt, turn = tilt_of(gravity)
    return round(math.degrees(tilt), 3) + 0.0, round(math.degrees(turn), 3) + 0.0


def build_driver(page: Page, views: Views) -> None:
    """The settings of External Control: a form on an emulator, instructions on a robot."""
    with page.panel("External Control", "installation-panel driver-panel"):
        with ui.column().classes("gap-2") as emulated:
            _driver_form(page, views)
        with ui.column().classes("gap-2") as real:
            _show_instructions(page)
        ui.label(
            "When a program with an External Control node is played, it requests its code from this driver."
        ).classes("soft")
    page.live.effect(_is_configurable, emulated.set_visibility)
    page.live.effect(lambda station: station.connected and not _is_configurable(station), real.set_visibility)


def _is_configurable(station: Station) -> bool:
    return station.emulator.available and "set_external_control" in station.emulator.verbs


def _driver_form(page: Page, views: Views) -> None:
    emulator = page.station.emulator
    with ui.row().classes("items-center no-wrap"):
        host = ui.input("Host IP").props("dense outlined data-testid=driver-host")
        port = ui.number("Custom port", precision=0).props("dense outlined data-testid=driver-port")

    async def read() -> None:
        found: dict[str, Any] = await emulator.call("external_control")
        host.set_value(found["host"])
        port.set_value(found["port"])

    async def save() -> None:
        if not host.value or port.value is None:
            raise ValueError("the address of a driver is a host and a port: fill in both")
        address = {"host": host.value, "port": int(port.value)}
        if installation_settings.can_be_saved(page.station):
            await emulator.call("change_installation", section="external_control", values=address)
            page.show_message("Saved in the installation file")
        else:
            await emulator.call("set_external_control", **address)
            page.show_message("In use until the emulator ends: it has no installation files")
        await read()

    with ui.row().classes("items-center"):
        ui.button("Save", on_click=page.handler(save)).props("no-caps data-testid=driver-save")
        own_address_button = ui.button("This machine", on_click=lambda: host.set_value(page.station.own_address))
        own_address_button.props("flat no-caps data-testid=driver-here")
    page.live.effect(
        lambda station: _is_configurable(station) and views.visible_view == "settings",
        lambda visible: page.run_in_background(read) if visible else None,
    )


def _show_instructions(page: Page) -> None:
    ui.label("On a robot this is set on its own teach pendant, below Installation, URCaps, External Control:")
    with ui.element("div").classes("facts"):
        ui.label("Host IP")
        page.live.text(lambda station: station.own_address or "no network route to the robot")
        ui.label("Custom port")
        ui.label(str(SENDER_PORT))
    ui.label("when the driver runs on the machine that serves this page.").classes("soft")


def build(page: Page) -> None:
    titles = {"settings": "Settings", "file": "File", "arm": "Robot"}
    with ui.column().classes("io"), Views(page, "installation", titles) as views:
        with views.view("settings", "installation-tool"):
            installation_tcp.build(page)
            with ui.column().classes("installation-column"):
                build_payload(page)
                build_mounting(page)
                build_driver(page, views)
        with views.view("file", "installation-file"):
            installation_settings.build(page, views)
        with views.view("arm", "installation-arm"):
            installation_arm.build(page, views)
