"""Move: the arm in three dimensions, buttons that move it while they are held, targets, freedrive."""

from client.pendant.arm_scene import arm_scene
from client.pendant.page import Page

__all__ = ["build"]


def build(page: Page) -> None:
    """Put it on the page."""
    arm_scene(page)
