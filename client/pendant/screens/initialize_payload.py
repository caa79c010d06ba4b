"""The payload that the controller reckons with."""

from typing import Final

from nicegui import ui

from client.pendant.page import Page
from client.pendant.station import Station

__all__ = ["payload_panel", "set_payload"]

_AXES: Final = ("CX", "CY", "CZ")
_MM: Final = 1e3
Payload = tuple[float, float, float, float]  # kg, mm


def payload_panel(page: Page) -> None:
    """Mass and centre of gravity: fields that follow the robot when it has others, and a button that sets them."""
    with page.panel("Active payload", "init-payload"):
        with ui.element("div").classes("init-payload-fields"):
            mass = _field("Mass", "kg", "payload-mass", "%.3f", least=0.0, step=0.1)
            cog = [_field(axis, "mm", f"payload-{axis.lower()}", "%.1f") for axis in _AXES]
            ui.button("Set", on_click=page.doing(lambda: _set(page.station, [mass, *cog]), "The payload is set")).props(
                "unelevated data-testid=payload-set"
            )
        page.live.text(_most, "init-hint")

    def show(payload: Payload | None) -> None:
        for field, value in zip((mass, *cog), payload or (None,) * 4, strict=True):
            field.set_value(value)

    page.live.effect(_active, show)


def _field(name: str, unit: str, mark: str, form: str, least: float | None = None, step: float = 1.0) -> ui.number:
    field = ui.number(name, format=form, min=least, step=step).props(
        f"outlined dense hide-bottom-space suffix={unit} data-testid={mark}"
    )
    return field.classes("number")


def _active(station: Station) -> Payload | None:
    mass, cog = station.values.get("payload"), station.values.get("payload_cog")
    if mass is None or cog is None:
        return None
    return (round(mass, 3), *(round(_MM * value, 1) for value in cog))


def _most(station: Station) -> str:
    model = station.model
    return "" if model is None else f"Rated payload {model.payload_max_kg:g} kg. Centre of gravity from the flange."


async def _set(station: Station, fields: list[ui.number]) -> None:
    if any(field.value is None for field in fields):
        raise ValueError("The payload needs a mass and three coordinates of its centre of gravity.")
    mass, *cog = (float(field.value) for field in fields)
    await set_payload(station, mass, [value / _MM for value in cog])


async def set_payload(station: Station, mass_kg: float, cog_m: list[float]) -> None:
    """Beside whatever program runs; an emulator in local control has a verb for it. Raises ValueError, ClientError."""
    if mass_kg < 0.0:
        raise ValueError(f"The payload cannot be {mass_kg:g} kg: a mass is 0 or more.")
    if station.behind.available and station.remote_control.value is False:
        await station.behind.change("set_payload", mass_kg=mass_kg, cog_m=cog_m)
    else:
        await station.say(f"set_payload({mass_kg!r}, {cog_m!r})")
