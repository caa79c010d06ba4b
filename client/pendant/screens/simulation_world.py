"""The objects around the arm: a list, a form to add one, fields to move one; and a view in which they are dragged."""

from collections.abc import Mapping, Sequence
from functools import partial
from math import degrees, dist, radians
from typing import Any, Final

from nicegui import ui

from client.pendant.arm_scene import arm_scene, camera_buttons
from client.pendant.page import Page
from client.pendant.polling import LatestRequest
from client.pendant.screens.simulation_arm import number_field, read_numbers
from client.pendant.station import Station
from urproto.robots.pose import rotvec_to_matrix
from urproto.vectors import ZERO3

_MM: Final = 1e3
_AXES: Final = ("x", "y", "z")
_POSE: Final = ("X", "Y", "Z", "RX", "RY", "RZ")
_SHAPES: Final = {"box": "Box", "sphere": "Sphere", "plane": "Plane"}
_DEFAULT_BOX_MM: Final = (100.0, 100.0, 100.0)
_DEFAULT_RADIUS_MM: Final = 50.0
_DEFAULT_POSE: Final = (350.0, 0.0, 50.0, 0.0, 0.0, 0.0)
_WRENCH: Final = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
_WRENCH_UNITS: Final = ("N",) * 3 + ("Nm",) * 3
_POSITION_DIGITS: Final = 4  # of metres: a tenth of a millimetre


def world_tab(page: Page) -> None:
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


def scene_panel(page: Page) -> None:
    with ui.card().classes("panel sim-scene"):
        with ui.element("div").classes("sim-view"):
            scene = arm_scene(page)
            camera_buttons(page, scene)
            with ui.element("div").classes("sim-overlay"):
                ui.label("Drag the ball to push the tool, or objects to move them (Shift: vertically)")
                page.live.text(_measured_text, "sim-force").props("data-testid=measured-force")
            data_element = ui.element("div").classes("hidden").props("data-testid=surroundings")
        keep_pushing = _wrench_form(page)
    page.live.bind(data_element, "value", _surroundings)
    ui.run_javascript(f"pendant.surroundings({data_element.id}, {scene.id})")
    emulator = page.station.emulator
    push_requests = LatestRequest[Sequence[float] | None](partial(_push_or_release, page.station), page.show_error)
    move_requests = LatestRequest[dict[str, Any]](
        lambda moved: emulator.change("move_object", **moved), page.show_error
    )
    dragging = [False]

    def push(force: Any) -> None:
        force = force if _is_vector(force) else None
        if force is not None or (dragging[0] and not keep_pushing.value):
            push_requests.submit(force)
        dragging[0] = force is not None

    def move(message: Any) -> None:
        if not isinstance(message, dict) or not _is_vector(message.get("position")):
            return
        obj = (objects(page.station) or {}).get(message.get("name"))
        if obj is not None:
            move_requests.submit({"name": message["name"], "pose": [*message["position"], *obj["pose"][3:]]})

    page.live.on_message("push", push)
    page.live.on_message("move_object", move)


def _is_vector(message: Any) -> bool:
    return (
        isinstance(message, list)
        and len(message) == len(ZERO3)
        and all(isinstance(value, int | float) for value in message)
    )


def _wrench_form(page: Page) -> ui.checkbox:
    """Fields for pushing the tool with an exact wrench."""
    emulator = page.station.emulator
    with ui.element("div").classes("sim-six"):
        fields = [
            number_field(name, unit, f"wrench-{name.lower()}")
            for name, unit in zip(_WRENCH, _WRENCH_UNITS, strict=True)
        ]
    with ui.element("div").classes("sim-row"):
        frame = ui.toggle({"base": "Base", "tool": "Tool"}, value="base").props("unelevated no-caps")
        frame.props("data-testid=wrench-frame").tooltip("Frame in which the numbers are given")

        async def push() -> None:
            await emulator.change("push_tool", wrench=read_numbers(fields, "The wrench"), frame=frame.value)

        ui.button("Push", icon="front_hand", on_click=page.handler(push)).props(
            "unelevated no-caps data-testid=wrench-push"
        ).classes("sim-button")
        release = ui.button("Release", on_click=page.handler(lambda: emulator.change("release_tool")))
        release.props("outline no-caps data-testid=wrench-release").classes("sim-button")
        keep_pushing = ui.checkbox("Keep pushing").props("dense data-testid=wrench-keep")
        keep_pushing.tooltip("Keep pushing when the ball is let go, until Release")

    def show(push_state: Mapping[str, Any] | None) -> None:
        release.set_enabled(push_state is not None)
        if push_state is not None:
            frame.set_value(push_state["frame"])
            for field, value in zip(fields, push_state["wrench"], strict=True):
                field.set_value(round(value, 1))

    page.live.effect(_current_push, show)
    return keep_pushing


async def _push_or_release(station: Station, force: Sequence[float] | None) -> None:
    if force is not None:
        await station.emulator.change("push_tool", wrench=[*force, *ZERO3], frame="base")
    elif (await station.emulator.call("world"))["push"] is not None:
        await station.emulator.change("release_tool")


def _current_push(station: Station) -> Any:
    return (station.emulator.read("world") or {}).get("push")


def objects(station: Station) -> Any:
    """The objects around the arm by name; None while they are unknown."""
    return (station.emulator.read("world") or {}).get("objects")


def _surroundings(station: Station) -> dict[str, Any] | None:
    """The data for the browser: position of the tool, force that pushes it (base frame), objects around it.

    None before the first state.
    """
    pose = station.values.get("actual_TCP_pose")
    if pose is None:
        return None
    tool = [round(value, _POSITION_DIGITS) for value in pose[:3]]
    return {
        "tool": tool,
        "force": _base_force(_current_push(station), pose),
        "objects": [{"name": name, **obj} for name, obj in (objects(station) or {}).items()],
    }


def _base_force(push: Mapping[str, Any] | None, pose: Sequence[float]) -> list[float]:
    if push is None:
        return [*ZERO3]
    force = push["wrench"][:3]
    if push["frame"] == "base":
        return list(force)
    rotation = rotvec_to_matrix(pose[3], pose[4], pose[5])
    return [sum(rotation[3 * row + column] * force[column] for column in range(3)) for row in range(3)]


def _measured_text(station: Station) -> str:
    wrench = station.values.get("actual_TCP_force")
    if wrench is None:
        return ""
    return f"Measured {dist(wrench[:3], ZERO3):.1f} N ({', '.join(f'{value:.1f}' for value in wrench[:3])})"
