"""The planning scene of a pendant: built from an emulator's world or a file, and rebuilt when it changes."""

import asyncio
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from client.cli import app
from client.errors import PlanningError, SceneError
from client.pendant.scene_monitor import (
    MonitoredScene,
    SceneMonitor,
    SceneSources,
    build_scene,
    links_in,
    missing_extra,
)
from client.planning import Box, Sphere
from emulator.servers.primary_state import configuration_data, kinematics_info
from urproto.compat_asyncio import timeout
from urproto.robots import load_model

UR3 = load_model("ur3")
ARM, KINEMATICS = configuration_data(UR3), kinematics_info(UR3)
TCP = (0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
BOX = {"box": [0.1, 0.2, 0.3], "pose": [0.3, 0.0, 0.15, 0.0, 0.0, 0.0], "stiffness": 1e4}
POINT = {"sphere": 0.0, "pose": [0.0] * 6}
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def world(objects: Mapping[str, Any], tool: Mapping[str, Any] = POINT) -> dict[str, Any]:
    """As the verb of this name returns it."""
    return {"objects": objects, "tool": tool, "push": None, "payload": None}


def build(world_data: Mapping[str, Any] | None = None, file: Path | None = None) -> MonitoredScene:
    monitored = build_scene(SceneSources(ARM, KINEMATICS, TCP, world_data), file)
    assert monitored is not None
    return monitored


def test_emulator_world_becomes_scene() -> None:
    plane = {"plane": {}, "pose": [0.0, 0.0, -0.1, 0.0, 0.0, 0.0]}
    monitored = build(world({"box": BOX, "floor": plane}))
    assert monitored.scene.objects["box"].shape == Box((0.1, 0.2, 0.3))
    assert [obj["name"] for obj in monitored.objects] == ["box", "floor"]
    assert monitored.objects[0]["box"] == [0.1, 0.2, 0.3]
    assert monitored.objects[0]["pose"][:3] == [0.3, 0.0, 0.15]
    assert "tool" not in monitored.scene.objects  # a point has no extent


def test_tool_is_attached_relative_to_tcp() -> None:
    tool = {"sphere": 0.03, "pose": [0.0, 0.0, 0.02, 0.0, 0.0, 0.0]}
    attached = build(world({}, tool)).scene.objects["tool"]
    assert attached.attached
    assert attached.shape == Sphere(0.03)
    assert attached.pose == pytest.approx((0.0, 0.0, 0.12, 0.0, 0.0, 0.0))


def test_scene_file_replaces_world_and_meshes_become_hulls(tmp_path: Path) -> None:
    (tmp_path / "tip.obj").write_text(TETRAHEDRON)
    file = tmp_path / "cell.yaml"
    file.write_text("objects:\n  tip: {mesh: tip.obj, pose: [0.5, 0, 0]}\n  rod: {cylinder: [0.03, 0.5]}\n")
    drawn = {obj["name"]: obj for obj in build(world({"box": BOX}), file).objects}
    assert set(drawn) == {"tip", "rod"}
    assert drawn["rod"]["cylinder"] == [0.03, 0.5]
    assert sorted(drawn["tip"]["mesh"]["points"]) == [[0, 0, 0], [0, 0, 1], [0, 1, 0], [1, 0, 0]]
    assert sorted(map(sorted, drawn["tip"]["mesh"]["triangles"])) == [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]


def test_colliding_objects_and_links_are_identified() -> None:
    q = (0.0, -1.4, 1.5, -1.7, -1.5, 0.0)
    flange = build().scene.kinematics.forward(q)
    monitored = build(world({"ball": {"sphere": 0.03, "pose": list(flange)}}))
    pairs = monitored.checker.collisions(q)
    assert {pair.other for pair in pairs} == {"ball"}
    assert 6 in links_in(pairs)
    assert "wrist_3_link is" in str(pairs[0])


def test_invalid_sources_are_reported() -> None:
    assert build_scene(SceneSources(ARM, KINEMATICS), None) is None
    with pytest.raises(SceneError, match="wheel has an unknown shape"):
        build(world({"wheel": {"torus": 0.1, "pose": [0.0] * 6}}))
    with pytest.raises(PlanningError, match="not a known model"):
        build_scene(SceneSources(replace(ARM, robot_type=99), KINEMATICS, TCP), None)


def test_scene_is_rebuilt_when_world_changes() -> None:
    async def run() -> None:
        changed = asyncio.Event()
        monitor = SceneMonitor(None, changed.set)

        async def next_scene(world_data: Mapping[str, Any]) -> MonitoredScene | None:
            changed.clear()
            sources = SceneSources(ARM, KINEMATICS, TCP, world_data)
            monitor.update(sources)
            async with timeout(20.0):
                await changed.wait()
            return monitor.update(sources)

        first = await next_scene(world({"box": BOX}))
        assert first is not None
        assert monitor.update(SceneSources(ARM, KINEMATICS, TCP, world({"box": BOX}))) is first
        second = await next_scene(world({}))
        assert second is not None
        assert second is not first
        assert not second.objects
        assert await next_scene(world({"box": {"box": [0.0, 0.1, 0.1]}})) is None
        assert "box: edge lengths: 3 numbers above 0" in monitor.problem
        assert await next_scene(world({})) is not None
        assert not monitor.problem
        await monitor.close()

    asyncio.run(run())


def test_missing_extra_names_installation(monkeypatch: pytest.MonkeyPatch) -> None:
    assert missing_extra() == ""
    monkeypatch.setitem(sys.modules, "ompl", None)
    assert missing_extra().endswith("[plan]'")


def test_invalid_scene_file_is_refused_at_start(tmp_path: Path) -> None:
    file = tmp_path / "cell.yaml"
    run = CliRunner().invoke
    missing = run(app, ["pendant", "--scene", str(file)], env={"COLUMNS": "200"})
    assert missing.exit_code == 2
    assert "cannot read" in missing.output
    file.write_text("objects: {post: {cylinder: [0.03]}}")
    broken = run(app, ["pendant", "--scene", str(file)])
    assert broken.exit_code != 0
    assert "cell.yaml" in broken.output + str(broken.exception)
