"""The arm and the objects around it, in 3D; a ball at its tool is dragged to push it."""

from collections.abc import Mapping, Sequence
from functools import partial
from math import dist
from typing import Any, Final

from nicegui import ui

from client.pendant.arm_scene import arm_scene, camera_buttons
from client.pendant.page import Page
from client.pendant.polling import LatestRequest
from client.pendant.screens.simulation_arm import number_field, read_numbers
from client.pendant.station import Station
from urproto.robots.pose import rotvec_to_matrix
from urproto.vectors import ZERO3

_NAMES: Final = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
_UNITS: Final = ("N",) * 3 + ("Nm",) * 3
_POSITION_DIGITS: Final = 4  # of metres: a tenth of a millimetre


def scene_panel(page: Page) -> None:
    """Add the panel to the page."""
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
        fields = [number_field(name, unit, f"wrench-{name.lower()}") for name, unit in zip(_NAMES, _UNITS, strict=True)]
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
    """The pushing force in the base frame."""
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
