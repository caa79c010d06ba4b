"""Sliders that the arm follows: sent trajectories, and reasons to stop. See also test_browser_controllers."""

import asyncio
from typing import Any, cast

import pytest

from client.errors import ManagerError
from client.pendant.manager_link import ControlPanel, ManagerLink
from urproto.errors import RobotRefused
from urproto.joints import JOINT_NAMES
from urproto.robots import load_model

MODEL = load_model("ur3")
SCALED = "scaled_joint_trajectory_controller"
JTC = {
    "name": SCALED,
    "type": "ur_controllers/ScaledJointTrajectoryController",
    "state": "active",
    "joints": [f"left_{name}" for name in reversed(JOINT_NAMES)],
}


class Link:
    """A manager that accepts everything."""

    def __init__(self) -> None:
        self.controllers: tuple[dict[str, Any], ...] = (JTC,)
        self.active_panel: ControlPanel | None = None
        self.sent: list[dict[str, Any]] = []
        self.failure = ""

    async def request(self, operation: str, /, **arguments: Any) -> None:
        if self.failure:
            raise ManagerError(self.failure)
        assert operation == "joint_trajectory"
        self.sent.append(arguments)


class Bench:
    def __init__(self) -> None:
        self.link = Link()
        self.q: tuple[float, ...] | None = (0.0, -1.5, 0.0, -1.5, 0.0, 0.0)
        self.ended: list[str] = []
        self.panel = self.another_panel()
        self.panel.on_end.append(self.ended.append)

    def another_panel(self) -> ControlPanel:
        panel = ControlPanel(cast(ManagerLink, self.link), lambda: None if self.q is None else (self.q, MODEL))
        panel.select_controller(SCALED)
        return panel


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    monkeypatch.setattr(ControlPanel, "COMMAND_HZ", 200.0)  # faster, to shorten the test
    return Bench()


async def settle() -> None:
    for _ in range(5):
        await asyncio.sleep(0.005)


async def test_trajectories_have_one_point_and_duration_of_rqt(bench: Bench) -> None:
    panel = bench.panel
    panel.enable()
    assert panel.targets == bench.q  # nothing jumps
    await settle()
    target = [3.0, -1.5, 0.0, -1.5, 0.0, 0.0]
    panel.set_targets(target)
    await settle()
    panel.disable()
    first, last = bench.link.sent[0]["trajectory"], bench.link.sent[-1]["trajectory"]
    assert first["joint_names"] == [f"left_{name}" for name in JOINT_NAMES]
    assert first["points"] == [{"positions": bench.q, "time_from_start_s": 0.5 / 0.5}]  # the minimum, at 50 %
    assert last["points"] == [{"positions": tuple(target), "time_from_start_s": 3.0 / MODEL.qd_max[0] / 0.5}]
    panel.scaling = 0.01
    panel.targets = (0.0,) * 6
    assert panel.duration_s((0.0,) * 6, MODEL.qd_max) == pytest.approx(50.0)
    count = len(bench.link.sent)
    await settle()
    assert (len(bench.link.sent), bench.ended) == (count, [""])


async def test_panel_is_disabled_on_failure_or_disconnection(bench: Bench) -> None:
    panel, link = bench.panel, bench.link
    for end_it, reason in (
        (lambda: setattr(link, "failure", "the manager has ended"), "the manager has ended"),
        (lambda: setattr(bench, "q", None), "the robot has stopped answering"),
        (lambda: setattr(link, "controllers", ()), "no longer controls the six joints"),
        (lambda: panel.set_targets(None), ""),  # the browser has disconnected
        (lambda: panel.select_controller("another"), ""),
    ):
        panel.enable()
        await settle()
        end_it()
        await settle()
        assert not panel.enabled
        assert link.active_panel is None
        assert reason in bench.ended.pop()
        bench.q, link.controllers, link.failure = (0.0,) * 6, (JTC,), ""
        panel.select_controller(SCALED)


async def test_only_one_browser_with_active_controller_may_drive(bench: Bench) -> None:
    bench.panel.enable()
    other = bench.another_panel()
    with pytest.raises(RobotRefused, match="the sliders of another browser control the arm"):
        other.enable()
    bench.panel.disable()
    bench.link.controllers = ({**JTC, "state": "inactive"},)
    with pytest.raises(RobotRefused, match="no joint trajectory controller is active"):
        other.enable()


@pytest.mark.parametrize("message", ["x", [1.0] * 5, [float("nan")] * 6, [True] * 6, ["1"] * 6, {}])
async def test_invalid_slider_values_are_rejected(bench: Bench, message: Any) -> None:
    bench.panel.enable()
    with pytest.raises(ValueError, match="sliders send six numbers"):
        bench.panel.set_targets(message)
    bench.panel.set_targets([1e6, -1e6, 0.0, 0.0, 0.0, 0.0])  # beyond the joints' limits
    lows, highs = MODEL.position_limits
    assert bench.panel.targets[:2] == (highs[0], lows[1])
    bench.panel.disable()
