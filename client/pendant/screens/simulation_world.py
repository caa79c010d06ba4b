"""The objects around the arm: a list, a form to add one, and fields to move one."""

from collections.abc import Mapping
from functools import partial
from math import degrees, radians
from typing import Any, Final

from nicegui import ui

from client.pendant.page import Page
from client.pendant.screens.simulation_arm import number_field, read_numbers
from client.pendant.screens.simulation_scene import objects

_MM: Final = 1e3
_AXES: Final = ("x", "y", "z")
_POSE: Final = ("X", "Y", "Z", "RX", "RY", "RZ")
_SHAPES: Final = {"box": "Box", "sphere": "Sphere", "plane": "Plane"}
_DEFAULT_BOX_MM: Final = (100.0, 100.0, 100.0)
_DEFAULT_RADIUS_MM: Final = 50.0
_DEFAULT_POSE: Final = (350.0, 0.0, 50.0, 0.0, 0.0, 0.0)


def world_tab(page: Page) -> None:
    """Add the tab to the page."""
    with ui.element("div").classes("sim-stack"):
        _add_form(page)
        ui.label("Objects").classes("panel-title")
        rows = ui.element("div").classes("sim-rows").props("data-testid=objects")

    fields: dict[str, list[ui.number]] = {}
    sizes: dict[str, str] = {}

    def show(found: Mapping[str, Any] | None) -> None:
        """Keep the rows while only poses change, because a user may be typing there."""
        found = found or {}
        current = {name: _size(obj) for name, obj in found.items()}
        if current != sizes or not fields:
            sizes.clear()
            sizes.update(current)
            fields.clear()
            rows.clear()
            with rows:
                fields.update({name: _object_row(page, name, obj) for name, obj in found.items()})
                if not found:
                    ui.label("There are no objects around the arm.").classes("init-hint")
        for name, obj in found.items():
            for field, value in zip(fields[name], _from_si(obj["pose"]), strict=True):
                field.set_value(value)

    page.live.effect(objects, show)


def object_description(
    shape: str, size_mm: list[float], pose: list[float], material: Mapping[str, float]
) -> dict[str, Any]:
    """The description of an object for ``add_object``. pose: mm and degrees."""
    sizes: dict[str, Any] = {
        "plane": {},
        "sphere": size_mm[0] / _MM if size_mm else 0.0,
        "box": [value / _MM for value in size_mm],
    }
    return {shape: sizes[shape], "pose": _to_si(pose), **material}


def _to_si(pose: list[float]) -> list[float]:
    return [*(value / _MM for value in pose[:3]), *(radians(value) for value in pose[3:])]


def _from_si(pose_si: list[float]) -> list[float]:
    return [*(round(_MM * value, 1) for value in pose_si[:3]), *(round(degrees(value), 1) for value in pose_si[3:])]


def _pose_fields(pose: list[float] | tuple[float, ...], test_id: str) -> list[ui.number]:
    units = ("mm",) * 3 + ("°",) * 3
    return [
        number_field(name, unit, f"{test_id}-{name.lower()}", value)
        for name, unit, value in zip(_POSE, units, pose, strict=True)
    ]


def _add_form(page: Page) -> None:
    with ui.element("div").classes("sim-row"):
        name = ui.input("Name").props("outlined dense data-testid=object-name").classes("sim-grow")
        shape = ui.toggle(_SHAPES, value="box").props("unelevated no-caps data-testid=object-shape")
        add = ui.button("Add", icon="add").props("unelevated no-caps data-testid=object-add").classes("sim-button")
    with ui.element("div").classes("sim-six"):
        box = [
            number_field(f"Size {axis}", "mm", f"size-{axis}", value)
            for axis, value in zip(_AXES, _DEFAULT_BOX_MM, strict=True)
        ]
        radius = number_field("Radius", "mm", "radius", _DEFAULT_RADIUS_MM)
        stiffness = number_field("Stiffness", "N/mm", "stiffness", 20.0)
        damping = number_field("Damping", "N s/mm", "damping", 0.2, "%.2f")
        friction = number_field("Friction", "", "friction", 0.0, "%.2f")
    with ui.element("div").classes("sim-six"):
        pose = _pose_fields(_DEFAULT_POSE, "pose")
    for field in box:
        field.bind_visibility_from(shape, "value", value="box")
    radius.bind_visibility_from(shape, "value", value="sphere")

    async def add_object() -> None:
        sizes = {"box": box, "sphere": [radius], "plane": []}[shape.value]
        k, d, mu = read_numbers([stiffness, damping, friction], "The material")
        material = {"stiffness": _MM * k, "damping": _MM * d, "friction": mu}
        obj = object_description(shape.value, read_numbers(sizes, "The size"), read_numbers(pose, "The pose"), material)
        object_name = (name.value or "").strip() or _free_name(shape.value, objects(page.station) or {})
        await page.station.emulator.change("add_object", name=object_name, description=obj)
        name.set_value("")

    add.on_click(page.handler(add_object))


def _free_name(shape: str, taken: Mapping[str, Any]) -> str:
    names = (shape if count == 1 else f"{shape} {count}" for count in range(1, len(taken) + 2))
    return next(name for name in names if name not in taken)


def _object_row(page: Page, name: str, obj: Mapping[str, Any]) -> list[ui.number]:
    emulator = page.station.emulator
    with ui.element("div").classes("sim-object").props("data-testid=object"):
        with ui.element("div").classes("sim-row"):
            ui.icon({"box": "check_box_outline_blank", "sphere": "circle"}.get(_shape(obj), "layers"))
            ui.label(name).classes("sim-fault-kind")
            ui.label(_size(obj)).classes("init-hint")
            ui.space()
            remove = page.handler(partial(emulator.change, "remove_object", name=name))
            ui.button(icon="delete", on_click=remove).props(f'flat round dense aria-label="Remove {name}"')
        with ui.element("div").classes("sim-six"):
            fields = _pose_fields(_from_si(obj["pose"]), f"move-{name}")

        async def move() -> None:
            await emulator.change("move_object", name=name, pose=_to_si(read_numbers(fields, "The pose")))

        for field in fields:
            field.on("change", page.handler(move))
    return fields


def _shape(obj: Mapping[str, Any]) -> str:
    return next(shape for shape in _SHAPES if shape in obj)


def _size(obj: Mapping[str, Any]) -> str:
    shape = _shape(obj)
    if shape == "plane":
        return "solid below its x-y plane"
    if shape == "sphere":
        return f"radius {_MM * obj['sphere']:.0f} mm"
    return " × ".join(f"{_MM * value:.0f}" for value in obj["box"]) + " mm"
