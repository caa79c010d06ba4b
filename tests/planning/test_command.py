"""``ur-client plan`` without a robot: sequences, arcs, constraints, and refusals."""

import json

import pytest
from typer.testing import CliRunner

from tests.rows import each_row

pytest.importorskip("ompl")

from client.cli import app
from urproto.robots import kinematics_of, load_model

START = (0.4, -1.3, 1.6, -1.9, -1.5, 0.2)
ARM = kinematics_of(load_model("ur5e"))
X, Y, Z, *TURN = ARM.forward(START)


def pose(dx: float, dy: float, dz: float = 0.0) -> str:
    return f"p[{','.join(map(str, (X + dx, Y + dy, Z + dz, *TURN)))}]"


def plan(*goals: str) -> tuple[int, str]:
    line = ["plan", "--model", "ur5e", *goals, "--start", ",".join(map(str, START)), "--json"]
    done = CliRunner().invoke(app, line)
    return done.exit_code, f"{done.output} {done.exception}"


def test_a_line_blends_into_an_arc() -> None:
    code, output = plan(f"LIN {pose(0.0, 0.2)} blend=0.03", f"CIRC {pose(0.0, 0.0)} interim={X + 0.1},{Y + 0.1},{Z}")
    assert code == 0, output
    found = json.loads(output.removesuffix("None"))
    assert found["planner"] == "LIN, CIRC"
    places = [ARM.forward(q) for q in found["positions"]]
    assert max(place[0] for place in places) == pytest.approx(X + 0.1, abs=2e-3)
    assert places[-1][:3] == pytest.approx((X, Y, Z), abs=1e-4)
    assert all(abs(place[2] - Z) < 2e-3 for place in places)


def test_any_of_several_goals_is_accepted() -> None:
    code, output = plan(f"p[2,0,0,0,0,0] or {','.join(map(str, (0.5, *START[1:])))} or up")
    assert code == 0, output
    assert json.loads(output.removesuffix("None"))["positions"][-1] == pytest.approx((0.5, *START[1:]))


def test_the_orientation_of_the_start_is_kept() -> None:
    code, output = plan(pose(0.1, 0.2), "--keep-orientation", "0.02,0.02,0.02")
    assert code == 0, output
    assert (
        max(
            abs(turn - TURN[0])
            for turn in (ARM.forward(q)[3] for q in json.loads(output.removesuffix("None"))["positions"])
        )
        < 0.06
    )


@each_row(
    ("goals", "words"),
    [
        (("LIN up",), "PoseGoal"),
        (("up blend=wide",), "blend is a radius"),
        (("up blend=0.1 blend=0.2",), "blend twice"),
        ((f"LIN {pose(0.0, 0.1)} center=0,0,0",), "for an arc give CIRC"),
        ((f"CIRC {pose(0.0, 0.1)} center=0,0",), "three numbers"),
        (("1,2,3",), "six joint angles"),
        (("up", "--model", "ur4"), "unknown robot model 'ur4': choose one of ur3"),
        ((pose(0.0, 0.1), "--keep-within", "1,1,1"), "six numbers"),
        ((pose(0.0, 0.1), "--keep-orientation", "-1,0,0"), "from 0 to"),
    ],
)
def test_invalid_goals_are_refused_with_the_reason(goals: tuple[str, ...], words: str) -> None:
    code, output = plan(*goals)
    assert code
    assert words in " ".join(output.replace("│", "").split())
