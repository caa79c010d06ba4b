"""Depth and normal of planes, boxes and spheres, against coal."""

import coal
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.world.shapes import Box, Plane, Sphere, WorldObject
from tests.rows import each_row

lengths = st.floats(0.01, 0.5)
places = st.floats(-0.6, 0.6)
turns = st.floats(-3.0, 3.0)
poses = st.tuples(places, places, places, turns, turns, turns)
shapes = st.one_of(st.builds(Plane), st.builds(Sphere, lengths), st.builds(Box, st.tuples(lengths, lengths, lengths)))


def coal_geometry(shape):
    if isinstance(shape, Box):
        return coal.Box(*shape.size)
    if isinstance(shape, Sphere):
        return coal.Sphere(shape.radius)
    return coal.Halfspace(np.array((0.0, 0.0, 1.0)), 0.0)


def coal_placement(pose):
    angle = float(np.linalg.norm(pose[3:]))
    axis = np.array(pose[3:]) / angle if angle else np.array((1.0, 0.0, 0.0))
    x, y, z = axis * np.sin(angle / 2)
    return coal.Transform3s(coal.Quaternion(np.cos(angle / 2), x, y, z).toRotationMatrix(), np.array(pose[:3]))


def coal_depth(shape, pose, point, radius):
    place, ball = coal.Transform3s(np.eye(3), np.array(point)), coal.Sphere(radius)
    result = coal.DistanceResult()
    return -coal.distance(coal_geometry(shape), coal_placement(pose), ball, place, coal.DistanceRequest(), result)


@given(shapes, poses, st.tuples(places, places, places), st.floats(0.001, 0.2))
def test_depth_and_normal_match_coal(shape, pose, point, radius):
    """Only along the normal does the depth shrink as fast as the ball moves."""
    touch = WorldObject(shape, pose).touch(point, radius)
    assert touch.depth == pytest.approx(coal_depth(shape, pose, point, radius), abs=2e-6)
    moved = tuple(at + 1e-3 * step for at, step in zip(point, touch.out, strict=True))
    assert coal_depth(shape, pose, moved, radius) == pytest.approx(touch.depth - 1e-3, abs=3e-6)


@given(shapes, poses, st.tuples(places, places, places), st.floats(0.0, 0.2))
def test_moving_along_the_normal_by_the_depth_ends_the_contact(shape, pose, point, radius):
    """After moving by its depth, a ball just touches any shape."""
    obj = WorldObject(shape, pose)
    touch = obj.touch(point, radius)
    assert sum(part * part for part in touch.out) == pytest.approx(1.0)
    freed = tuple(at + touch.depth * step for at, step in zip(point, touch.out, strict=True))
    assert obj.touch(freed, radius).depth == pytest.approx(0.0, abs=1e-9)


def test_the_probes_of_a_box_are_its_corners_with_a_quarter_face_each():
    probes = Box((0.2, 0.4, 0.6)).probes
    corners = {(x, y, z) for x in (-0.1, 0.1) for y in (-0.2, 0.2) for z in (-0.3, 0.3)}
    assert {probe.centre for probe in probes} == corners
    assert sum(probe.share for probe in probes if probe.centre[2] < 0) == 1.0


@each_row(
    ("wrong", "message"),
    [
        (lambda: Sphere(-0.1), "radius"),
        (lambda: Sphere(float("nan")), "radius"),
        (lambda: Box((0.1, 0.0, 0.1)), "size"),
        (lambda: Box((0.1, 0.1)), "size"),
        (lambda: WorldObject(Plane(), (0.0,) * 5), "pose"),
        (lambda: WorldObject(Plane(), (0.0, 0.0, float("inf"), 0.0, 0.0, 0.0)), "pose"),
        (lambda: WorldObject(Plane(), stiffness=0.0), "stiffness"),
        (lambda: WorldObject(Plane(), damping=-1.0), "damping"),
        (lambda: WorldObject(Plane(), friction=float("nan")), "friction"),
    ],
)
def test_invalid_shapes_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong()
