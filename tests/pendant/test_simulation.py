"""Simulation without a browser."""

import json
from math import pi
from types import SimpleNamespace

import pytest

from client.pendant.screens.simulation_arm import read_document
from client.pendant.screens.simulation_world import _surroundings, object_description
from emulator.world.file import read_object


def station(push=None, objects=None, pose=(0.1, 0.2, 0.3, 0.0, 0.0, pi / 2)):
    emulator = SimpleNamespace(read=lambda verb: {"push": push, "objects": objects or {}})
    return SimpleNamespace(values={"actual_TCP_pose": pose}, emulator=emulator)


@pytest.mark.parametrize(("frame", "force"), [("base", [10.0, 0.0, 0.0]), ("tool", [0.0, 10.0, 0.0])])
def test_push_is_drawn_in_base_frame(frame, force) -> None:
    robot = station({"wrench": [10.0, 0.0, 0.0, 0.0, 0.0, 0.0], "frame": frame})
    assert _surroundings(robot)["force"] == pytest.approx(force)


def test_objects_are_drawn_at_their_poses() -> None:
    drawn = _surroundings(station(objects={"ball": {"sphere": 0.1, "pose": [1, 2, 3, 0, 0, pi]}}))
    assert drawn["tool"] == [0.1, 0.2, 0.3]
    (ball,) = drawn["objects"]
    assert (ball["name"], ball["sphere"], ball["pose"]) == ("ball", 0.1, [1, 2, 3, 0, 0, pi])


@pytest.mark.parametrize(
    ("shape", "size_mm", "size"), [("box", [100.0, 50.0, 20.0], [0.1, 0.05, 0.02]), ("sphere", [30.0], 0.03)]
)
def test_form_creates_valid_description(shape, size_mm, size) -> None:
    pose = [100.0, 0.0, -50.0, 0.0, 180.0, 0.0]
    description = object_description(shape, size_mm, pose, {"stiffness": 1e4, "damping": 10.0, "friction": 0.5})
    assert description[shape] == pytest.approx(size)
    obj = read_object("it", description)
    assert obj.pose == pytest.approx((0.1, 0.0, -0.05, 0.0, pi, 0.0))
    assert (obj.stiffness, obj.friction) == (1e4, 0.5)


def test_plane_has_no_size() -> None:
    assert (
        read_object("it", object_description("plane", [], [0.0] * 6, {})).shape == read_object("p", {"plane": {}}).shape
    )


def test_saved_state_is_read_and_invalid_data_refused() -> None:
    assert read_document(json.dumps({"format": 1}).encode()) == {"format": 1}
    for nonsense in (b"\xff\xfe", b"[1]", b"{", b"[" * 5000):
        with pytest.raises(ValueError, match="not a saved state"):
            read_document(nonsense)
