"""The arm in three dimensions: geometry made from the model's own numbers."""

from contextlib import ExitStack
from math import dist
from typing import Final

from nicegui import ui

from client.pendant.page import Page
from urproto.robots import RobotModel
from urproto.robots.calibration import chain_of
from urproto.robots.pose import Vec3
from urproto.robots.shapes import Capsule, capsules

__all__ = ["arm_scene"]

_GREY: Final = ("#c3c8ce", "#6f9fc4")  # of links in turn


def arm_scene(page: Page) -> ui.scene:
    """A scene with the arm, which appears once its model is known."""
    scene = ui.scene(grid=(4, 40), background_color="#e4e9ee", fps=30).classes("arm")
    page.live.effect(lambda station: station.model, lambda model: _put(scene, model))
    page.live.bind(scene, "joints", lambda station: station.values.get("actual_q"))
    return scene


def _put(scene: ui.scene, model: RobotModel | None) -> None:
    scene.clear()
    if model is None:
        return
    joints = list[str]()
    shapes = capsules(model)
    chain = chain_of(model.dh if model.calibration is None else model.calibration)
    with scene, ExitStack() as nested:
        _capsule(scene, shapes[0], _GREY[0])
        for i, (place, shape) in enumerate(zip(chain, shapes[1:], strict=True)):
            nested.enter_context(scene.group().move(*place.position).rotate(*place.rpy))
            joint = nested.enter_context(scene.group())
            joints.append(joint.id)
            _capsule(scene, shape, _GREY[(i + 1) % 2])
    reach = model.reach_m
    scene.move_camera(1.2 * reach, -1.2 * reach, 0.9 * reach, look_at_z=0.4 * reach, duration=0)
    scene.client.run_javascript(f"pendant.arm({scene.id}, {joints})")


def _capsule(scene: ui.scene, capsule: Capsule, color: str) -> None:
    start, end, radius = capsule.start, capsule.end, capsule.radius
    length = dist(start, end)
    for point in (start, end):
        scene.sphere(radius).move(*point).material(color)
    if length > 1e-6:
        middle = [(a + b) / 2 for a, b in zip(start, end, strict=True)]
        tube = scene.cylinder(radius, radius, length, 32).move(*middle).material(color)
        tube.rotate_R(_along([(b - a) / length for a, b in zip(start, end, strict=True)]))


def _along(axis: list[float]) -> list[list[float]]:
    """A rotation that turns y, which cylinders are along, to an axis."""
    other: Vec3 = (0.0, 0.0, 1.0) if abs(axis[2]) < 0.9 else (1.0, 0.0, 0.0)
    x = _cross(axis, other)
    size = dist(x, (0.0, 0.0, 0.0))
    x = [value / size for value in x]
    return [list(row) for row in zip(x, axis, _cross(x, axis), strict=True)]


def _cross(a: list[float] | Vec3, b: list[float] | Vec3) -> list[float]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
