"""Teleport the arm, set the true payload at its flange, and save its whole state to a file."""

import json
from collections.abc import Sequence
from math import degrees, radians
from typing import Any, Final

from nicegui import ui

from client.pendant.page import Page
from client.pendant.screens.payload import entered_payload, payload_fields
from client.pendant.station import Station
from urproto.joints import JOINT_TITLES
from urproto.robots import START_Q
from urproto.text import json_document

_MM: Final = 1e3
_MAX_MB: Final = 4  # limit of the control API


def arm_tab(page: Page) -> None:
    with ui.element("div").classes("sim-stack"):
        _pose_form(page)
        _payload_form(page)
        _state_form(page)


def read_numbers(fields: Sequence[ui.number], subject: str) -> list[float]:
    """The content of number fields. Raises ValueError if one is empty."""
    if any(field.value is None for field in fields):
        raise ValueError(f"{subject}: fill in every field.")
    return [float(field.value) for field in fields]


def number_field(label: str, unit: str, test_id: str, value: float = 0.0, format_: str = "%.1f") -> ui.number:
    field = ui.number(label, value=value, format=format_)
    return field.props(f'outlined dense hide-bottom-space suffix="{unit}" data-testid={test_id}').classes("number")


def _pose_form(page: Page) -> None:
    station = page.station
    ui.label("Pose of the arm").classes("panel-title")
    with ui.element("div").classes("sim-six"):
        fields = [number_field(name, "°", f"q{i}", format_="%.2f") for i, name in enumerate(JOINT_TITLES)]

    def fill(q: Sequence[float] | None) -> None:
        for field, value in zip(fields, q or [0.0] * 6, strict=True):
            field.set_value(round(degrees(value), 2))

    async def teleport() -> None:
        q = [radians(value) for value in read_numbers(fields, "The pose")]
        await station.emulator.change("set_joints", q_rad=q)

    with ui.element("div").classes("sim-row"):
        ui.button("Put the arm there", on_click=page.handler(teleport)).props("unelevated no-caps data-testid=put-arm")
        ui.button("As it is", on_click=lambda: fill(station.values.get("actual_q"))).props("outline no-caps")
        ui.button("Start pose", on_click=lambda: fill(START_Q)).props("outline no-caps data-testid=fill-start")
        ui.button("Zero", on_click=lambda: fill(None)).props("outline no-caps")
    fill(START_Q)


def _payload_form(page: Page) -> None:
    station = page.station
    ui.label("Payload on the flange").classes("panel-title")
    page.live.text(_mounted_text, "sim-text").props("data-testid=mounted")
    with ui.element("div").classes("sim-four"):
        fields = payload_fields("mount")

    async def mount() -> None:
        mass_kg, cog_m = entered_payload(fields)
        await station.emulator.change("mount_payload", mass_kg=mass_kg, cog_m=cog_m)

    with ui.element("div").classes("sim-row"):
        ui.button("Mount", on_click=page.handler(mount)).props("unelevated no-caps data-testid=mount")
        ui.button("As programs say", on_click=page.handler(lambda: station.emulator.change("mount_payload"))).props(
            "outline no-caps data-testid=unmount"
        )


def _mounted_text(station: Station) -> str:
    payload = (station.emulator.read("world") or {}).get("payload")
    if payload is None:
        return "The mounted payload is the one that programs set."
    cog = ", ".join(f"{_MM * value:.1f}" for value in payload["cog_m"])
    return f"{payload['mass_kg']:.3f} kg at {cog} mm are mounted, whatever payload programs set."


def _state_form(page: Page) -> None:
    station = page.station
    ui.label("State").classes("panel-title")
    ui.label("Everything that outlives a program, for an arm at rest, as a JSON file.").classes("init-hint")

    async def save() -> None:
        document = await station.emulator.call("save")
        name = f"{document['model']}-state.json"
        ui.download.content(json.dumps(document, indent=1), name, "application/json")

    async def restore(content: bytes, _: str) -> None:
        await station.emulator.change("restore", document=read_document(content))

    with ui.element("div").classes("sim-row"):
        ui.button("Save", icon="download", on_click=page.handler(save)).props(
            "unelevated no-caps data-testid=save-state"
        )
        pick = page.picker(
            ".json,application/json", "restore-upload", restore, "a state", _MAX_MB, "The state is restored"
        )
        ui.button("Restore", icon="upload", on_click=pick).props("outline no-caps data-testid=restore-state")


def read_document(content: bytes) -> dict[str, Any]:
    """Parse a saved state. Raises ValueError."""
    try:
        document = json_document(content)
    except (ValueError, UnicodeDecodeError) as error:
        raise ValueError(f"This file is not a saved state: {error}.") from error
    if not isinstance(document, dict):
        raise ValueError("This file is not a saved state: it has no JSON object.")
    return document
