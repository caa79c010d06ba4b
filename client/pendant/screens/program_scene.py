"""The arm in 3D, with the waypoints of the program and the path through them."""

from typing import Final

from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from client.pendant.arm_scene import arm_scene, camera_buttons
from client.pendant.page import Page
from client.pendant.program_draft import Selection

_RADIUS_M: Final = 0.012
_COLOR: Final = "#e08a00"
_SELECTED_COLOR: Final = "#2f7fb8"
_MAX_WAYPOINTS: Final = 300  # drawn waypoints; more would be unreadable


def program_scene(page: Page, selection: Selection) -> None:
    """Add the scene to the page. Lines between waypoints are straight, like those of MoveL."""
    with ui.card().classes("panel program-scene").props("data-testid=program-scene"):
        scene = arm_scene(page)
        camera_buttons(page, scene)
    spheres, lines = dict[str, Object3D](), list[Object3D]()

    def draw(waypoints: tuple[tuple[str, tuple[float, ...]], ...]) -> None:
        for drawn in (*spheres.values(), *lines):
            drawn.delete()
        spheres.clear()
        lines.clear()
        with scene:
            previous: tuple[float, ...] | None = None
            for node, position in waypoints[:_MAX_WAYPOINTS]:
                x, y, z = position
                spheres[node] = scene.sphere(_RADIUS_M).material(_COLOR).move(x, y, z).with_name(f"waypoint {node}")
                if previous is not None:
                    lines.append(scene.line(list(previous), list(position)).material(_COLOR))
                previous = position
        highlight(selection.node)

    def highlight(selected: str) -> None:
        for node, sphere in spheres.items():
            color = _SELECTED_COLOR if node == selected else _COLOR
            if sphere.color != color:
                sphere.material(color)

    draft = page.station.program_draft
    page.live.effect(lambda _: draft.view.waypoints(), draw)
    page.live.effect(lambda _: selection.node, highlight)
