"""Teleport the arm, set the true payload at its flange, and save its whole state to a file."""

import json
from collections.abc import Sequence
from math import degrees, radians
from typing import Any, Final

from nicegui import events, ui

from client.pendant.page import Page
from client.pendant.station import Station
from urproto.joints import JOINT_TITLES
from urproto.robots import START_Q
from urproto.text import json_document

_MM: Final = 1e3
_MOST_BYTES: Final = 4_000_000  # what the control API takes


def arm_tab(page: Page) -> None:
    """Put it there."""
    with ui.element("div").classes("sim-stack"):
        _pose(page)
        _payload(page)
        _state(page)


def numbers(fields: Sequence[ui.number], what: str) -> list[float]:
    """What is in number fields. Raises ValueError when one is empty."""
    if any(field.value is None for field in fields):
        raise ValueError(f"{what}: fill in every field.")
    return [float(field.value) for field in fields]


def number(label: str, unit: str, mark: str, value: float = 0.0, form: str = "%.1f") -> ui.number:
    """A field for a number, its unit behind it."""
    field = ui.number(label, value=value, format=form)
    return field.props(f'outlined dense hide-bottom-space suffix="{unit}" data-testid={mark}').classes("number")


def _pose(page: Page) -> None:
    station = page.station
    ui.label("Pose of the arm").classes("panel-title")
    with ui.element("div").classes("sim-six"):
        fields = [number(name, "°", f"q{i}", form="%.2f") for i, name in enumerate(JOINT_TITLES)]

    def fill(q: Sequence[float] | None) -> None:
        for field, value in zip(fields, q or [0.0] * 6, strict=True):
            field.set_value(round(degrees(value), 2))

    async def put() -> None:
        q = [radians(value) for value in numbers(fields, "The pose")]
        await station.emulator.change("set_joints", q_rad=q)

    with ui.element("div").classes("sim-row"):
        ui.button("Put the arm there", on_click=page.doing(put)).props("unelevated no-caps data-testid=put-arm")
        ui.button("As it is", on_click=lambda: fill(station.values.get("actual_q"))).props("outline no-caps")
        ui.button("Start pose", on_click=lambda: fill(START_Q)).props("outline no-caps data-testid=fill-start")
        ui.button("Zero", on_click=lambda: fill(None)).props("outline no-caps")
    fill(START_Q)


def _payload(page: Page) -> None:
    station = page.station
    ui.label("Payload on the flange").classes("panel-title")
    page.live.text(_mounted, "sim-text").props("data-testid=mounted")
    with ui.element("div").classes("sim-four"):
        mass = number("Mass", "kg", "mount-mass", form="%.3f")
        cog = [number(f"C{axis}", "mm", f"mount-c{axis.lower()}") for axis in "XYZ"]

    async def mount() -> None:
        mass_kg, *place = numbers([mass, *cog], "The payload")
        await station.emulator.change("mount_payload", mass_kg=mass_kg, cog_m=[value / _MM for value in place])

    with ui.element("div").classes("sim-row"):
        ui.button("Mount", on_click=page.doing(mount)).props("unelevated no-caps data-testid=mount")
        ui.button("As programs say", on_click=page.doing(lambda: station.emulator.change("mount_payload"))).props(
            "outline no-caps data-testid=unmount"
        )


def _mounted(station: Station) -> str:
    world = station.emulator.watch("world").value if station.emulator.available else None
    payload = None if world is None else world["payload"]
    if payload is None:
        return "The mounted payload is the one that programs set."
    cog = ", ".join(f"{_MM * value:.1f}" for value in payload["cog_m"])
    return f"{payload['mass_kg']:.3f} kg at {cog} mm are mounted, whatever payload programs set."


def _state(page: Page) -> None:
    station = page.station
    ui.label("State").classes("panel-title")
    ui.label("Everything that outlives a program, for an arm at rest, as a JSON file.").classes("init-hint")

    async def save() -> None:
        document = await station.emulator.call("save")
        name = f"{document['model']}-state.json"
        ui.download.content(json.dumps(document, indent=1), name, "application/json")

    async def restore(event: events.UploadEventArguments) -> None:
        async def take() -> None:
            await station.emulator.change("restore", document=read_document(await event.file.read()))

        await page.attempt(take, "The state is restored")
        upload.reset()

    with ui.element("div").classes("sim-row"):
        ui.button("Save", icon="download", on_click=page.doing(save)).props("unelevated no-caps data-testid=save-state")
        upload = ui.upload(on_upload=restore, auto_upload=True, max_file_size=_MOST_BYTES, max_files=1)
        upload.props("accept=.json,application/json data-testid=restore-upload").classes("sim-upload")
        ui.button("Restore", icon="upload", on_click=lambda: upload.run_method("pickFiles")).props(
            "outline no-caps data-testid=restore-state"
        )


def read_document(content: bytes) -> dict[str, Any]:
    """A state that was saved. Raises ValueError."""
    try:
        document = json_document(content)
    except (ValueError, UnicodeDecodeError) as error:
        raise ValueError(f"This file is not a saved state: {error}.") from error
    if not isinstance(document, dict):
        raise ValueError("This file is not a saved state: it has no JSON object.")
    return document
