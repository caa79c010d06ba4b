"""The form of the payload that the robot assumes, on several screens: mass and centre of gravity."""

from collections.abc import Sequence
from typing import Final

from nicegui import ui

from client.pendant.page import Page
from client.pendant.settings import apply_payload
from client.pendant.station import Station

_MM: Final = 1e3


def payload_fields(test_id: str) -> list[ui.number]:
    """Fields for mass [kg] and centre of gravity [mm]. test_id: what their names begin with."""
    mass = ui.number("Mass", format="%.3f", min=0.0, step=0.1).props(f"suffix=kg data-testid={test_id}-mass")
    cog = [
        ui.number(f"C{axis}", format="%.1f", step=1.0).props(f"suffix=mm data-testid={test_id}-c{axis.lower()}")
        for axis in "XYZ"
    ]
    return [field.props("outlined dense hide-bottom-space").classes("number") for field in (mass, *cog)]


def entered_payload(fields: Sequence[ui.number]) -> tuple[float, list[float]]:
    """Mass [kg] and centre of gravity [m]. Raises ValueError if a number is missing, or the mass is negative."""
    if any(field.value is None for field in fields):
        raise ValueError("The payload needs a mass and three coordinates of its centre of gravity.")
    mass, *cog = (float(field.value) for field in fields)
    if mass < 0.0:
        raise ValueError(f"The payload cannot be {mass:g} kg: a mass is 0 or more.")
    return mass, [value / _MM for value in cog]


def payload_form(page: Page, text: str, test_id: str) -> None:
    """Fields that follow the robot, and a button with a text that sets the payload."""

    async def apply() -> None:
        confirmed = await apply_payload(page.station, *entered_payload(fields))
        unconfirmed = "Payload sent; this version does not report which one it uses"
        page.show_message("Payload in use" if confirmed else unconfirmed)

    def show(payload: Sequence[float] | None) -> None:
        for field, value in zip(fields, payload or (None,) * len(fields), strict=True):
            field.set_value(value)

    with ui.element("div").classes("init-payload-fields"):
        fields = payload_fields("payload")
        button = page.needs_robot(ui.button(text, on_click=page.handler(apply)))
        button.props(f"unelevated no-caps data-testid={test_id}")
    page.live.text(_rated_payload, "init-hint")
    page.live.effect(active_payload, show)


def active_payload(station: Station) -> tuple[float, ...] | None:
    """The active mass [kg] and centre of gravity [mm]; None if it is not reported."""
    mass, cog = station.values.get("payload"), station.values.get("payload_cog")
    return None if mass is None or cog is None else (round(mass, 4), *(round(_MM * value, 3) + 0.0 for value in cog))


def _rated_payload(station: Station) -> str:
    model = station.model
    return "" if model is None else f"Rated payload {model.payload_max_kg:g} kg. Centre of gravity from the flange."
