"""Move: the arm in three dimensions, buttons that move it while they are held, targets, freedrive."""

from nicegui import ui

from client.pendant.arm_scene import arm_scene, camera_buttons
from client.pendant.page import Page

__all__ = ["build"]


def build(page: Page) -> None:
    """Put it on the page."""
    with ui.element("div").style("width:700px;height:640px;position:relative"):
        camera_buttons(page, arm_scene(page))
