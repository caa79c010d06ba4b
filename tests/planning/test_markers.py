"""A plan in its scene as a file for Foxglove, read by an independent library."""

import json
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from typer.testing import CliRunner

from client.cli import app
from urproto.robots import kinematics_of, load_model

START, GOAL = "-0.6,-1.2,1.4,-1.7,-1.5,0", "0.6,-1.2,1.4,-1.7,-1.5,0"
WORLD = """
objects:
  post: {box: [0.1, 0.1, 1.0], pose: [-0.5, 0.0, 0.5, 0, 0, 0]}
  ball: {sphere: 0.1, pose: [0.5, 0.5, 0.2, 0, 0, 0]}
tool: {cylinder: [0.02, 0.1], pose: [0, 0, 0.06, 0, 0, 0]}
"""


def test_a_plan_is_drawn_with_its_surroundings(tmp_path: Path) -> None:
    world, file = tmp_path / "world.yaml", tmp_path / "path.mcap"
    world.write_text(WORLD)
    order = ["plan", GOAL, "--model", "ur5e", "--start", START, "--scene", str(world), "--markers", str(file), "--json"]
    done = CliRunner().invoke(app, order)
    assert done.exit_code == 0, done.output
    plan = json.loads(done.stdout)
    received: dict[str, list[Any]] = {}
    with file.open("rb") as stream:
        for _, channel, _, message in make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            received.setdefault(channel.topic, []).append(message)
    first, *later = received["/planning_scene"]
    drawn = {marker.ns: marker for marker in first.markers}
    assert {name: marker.type for name, marker in drawn.items()} == {"post": 1, "ball": 2, "tool": 3}
    assert drawn["post"].header.frame_id == "base"
    assert (drawn["post"].scale.z, drawn["post"].pose.position.x) == (1.0, -0.5)
    assert drawn["ball"].scale.x == pytest.approx(0.2)
    arm = kinematics_of(load_model("ur5e"))
    (line,) = received["/planned_path"][0].markers
    assert line.type == 4
    assert len(line.points) == len(plan["positions"]) == len(received["/joint_states"])
    last = arm.forward(plan["positions"][-1])
    assert (line.points[-1].x, line.points[-1].y, line.points[-1].z) == pytest.approx(last[:3])
    tool = later[-1].markers[0]  # it moved with the arm
    assert tool.ns == "tool"
    assert [tool.pose.position.x, tool.pose.position.y, tool.pose.position.z] == pytest.approx(
        arm.forward(plan["positions"][-1], (0.0, 0.0, 0.06, 0.0, 0.0, 0.0))[:3]
    )
    assert CliRunner().invoke(app, order).exit_code != 0  # the file exists
