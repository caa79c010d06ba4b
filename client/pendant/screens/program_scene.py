"""The arm in 3D, with the waypoints of the program and the path through them."""

from typing import Final

from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from client.pendant.arm_scene import arm_scene, camera_buttons
from client.pendant.page import Page
from client.pendant.program_draft import Selection

_RADIUS_M: Final = 0.012
_COLOR: Final = "#e08a00"
_CHOSEN: Final = "#2f7fb8"
_MOST: Final = 300  # waypoints drawn; more are no picture any more


def program_scene(page: Page, selection: Selection) -> None:
    """Put it on the page. Waypoints are where their poses are; lines between them are straight, as those of MoveL."""
    with ui.card().classes("panel program-scene").props("data-testid=program-scene"):
        scene = arm_scene(page)
        camera_buttons(page, scene)
    balls, lines = dict[str, Object3D](), list[Object3D]()

    def draw(waypoints: tuple[tuple[str, tuple[float, ...]], ...]) -> None:
        for each in (*balls.values(), *lines):
            each.delete()
        balls.clear()
        lines.clear()
        with scene:
            before: tuple[float, ...] | None = None
            for node, place in waypoints[:_MOST]:
                x, y, z = place
                balls[node] = scene.sphere(_RADIUS_M).material(_COLOR).move(x, y, z).with_name(f"waypoint {node}")
                if before is not None:
                    lines.append(scene.line(list(before), list(place)).material(_COLOR))
                before = place
        mark(selection.node)

    def mark(chosen: str) -> None:
        for node, ball in balls.items():
            color = _CHOSEN if node == chosen else _COLOR
            if ball.color != color:
                ball.material(color)

    draft = page.station.program_draft
    page.live.effect(lambda _: draft.view.waypoints(), draw)
    page.live.effect(lambda _: selection.node, mark)
