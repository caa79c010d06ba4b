"""Payload and mounting."""

import math
from typing import Final

from nicegui import ui

from client.pendant.mounting import apply_gravity, apply_payload, gravity_of, tilt_of
from client.pendant.page import Page
from client.pendant.station import Station

__all__ = ["build_mounting", "build_payload"]

_MM: Final = 1000.0
_PLACES: Final = {"Floor": (0, 0), "Wall": (90, 0), "Ceiling": (180, 0)}  # degrees


def build_payload(page: Page) -> None:
    """Mass and centre of gravity that the robot reckons with."""
    station = page.station
    with page.panel("Payload", "installation-panel"):
        page.live.text(_payload, "now-line").props("data-testid=payload-now")
        with ui.element("div").classes("six four"):
            mass = _box("Mass [kg]", "payload-mass")
            cog = [_box(f"C{axis} [mm]", f"payload-c{axis.lower()}") for axis in "XYZ"]

        async def use() -> None:
            values = [box.value for box in (mass, *cog)]
            if any(value is None for value in values):
                raise ValueError("a payload has four numbers: fill in all of them")
            if values[0] < 0:
                raise ValueError(f"a payload of {values[0]:g} kg: a mass cannot be negative")
            if await apply_payload(station, values[0], [value / _MM for value in values[1:]]):
                page.tell("Payload in use")
            else:
                page.tell("Payload sent; this version does not tell which one it uses")

        with ui.row().classes("items-center"):
            ui.button("Use it", on_click=page.doing(use)).props("no-caps data-testid=payload-use")
            page.live.text(_limit, "soft")
    page.live.effect(_payload_values, lambda values: _fill((mass, *cog), values))


def build_mounting(page: Page) -> None:
    """How the base stands: which way gravity pulls."""
    station = page.station
    with page.panel("Mounting", "installation-panel"):
        page.live.text(_mounting, "now-line").props("data-testid=mounting-now")
        presets = ui.row().classes("items-center")
        with ui.element("div").classes("six two"):
            tilt = _box("Tilt [°]", "mount-tilt")
            turn = _box("Turn of the base [°]", "mount-turn")
        with presets:
            for name, angles in _PLACES.items():
                place = ui.button(name, on_click=lambda _, angles=angles: _fill((tilt, turn), angles))
                place.props(f"outline no-caps data-testid=mount-{name}")
        pull = ui.label().classes("soft").props("data-testid=mount-gravity")

        def wanted() -> tuple[float, float, float]:
            return gravity_of(math.radians(tilt.value or 0.0), math.radians(turn.value or 0.0))

        def tell() -> None:
            pull.set_text("Gravity felt by the base: " + ", ".join(f"{value:.3f}" for value in wanted()) + " m/s²")

        async def use() -> None:
            if await apply_gravity(station, wanted()):
                page.tell("Mounting in use")
            else:
                page.tell("Mounting sent; this version does not tell which one it uses")

        for box in (tilt, turn):
            box.on_value_change(tell)
        tell()
        with ui.row().classes("items-center"):
            ui.button("Use it", on_click=page.doing(use)).props("no-caps data-testid=mount-use")
            pull.move()
    page.live.effect(_tilt, lambda angles: _fill((tilt, turn), angles))


def _box(label: str, mark: str) -> ui.number:
    return ui.number(label, value=0.0).props(f"dense outlined hide-bottom-space data-testid={mark}")


def _fill(boxes: tuple[ui.number, ...], values: tuple[float, ...] | None) -> None:
    for box, value in zip(boxes, values or (), strict=False):
        box.set_value(value)


def _payload_values(station: Station) -> tuple[float, ...] | None:
    mass, cog = station.values.get("payload"), station.values.get("payload_cog")
    return None if mass is None or cog is None else (round(mass, 4), *(round(_MM * value, 3) + 0.0 for value in cog))


def _payload(station: Station) -> str:
    values = _payload_values(station)
    if values is None:
        return "This version does not tell its payload" if station.connected else "-"
    mass, x, y, z = values
    return f"In effect: {mass:.3f} kg at {x:.1f}, {y:.1f}, {z:.1f} mm"


def _limit(station: Station) -> str:
    model = station.model
    return "" if model is None else f"{model.title} carries {model.payload_max_kg:g} kg"


def _mounting(station: Station) -> str:
    angles = _tilt(station)
    if angles is None:
        return "This version does not tell how it is mounted" if station.connected else "-"
    return f"In effect: tilt {angles[0]:.1f}°, turn {angles[1]:.1f}°"


def _tilt(station: Station) -> tuple[float, float] | None:
    gravity = station.values.get("target_gravity")
    if gravity is None:
        return None
    tilt, turn = tilt_of(gravity)
    return round(math.degrees(tilt), 3) + 0.0, round(math.degrees(turn), 3) + 0.0
