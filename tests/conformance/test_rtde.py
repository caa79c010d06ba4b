"""RTDE guide: negotiation, recipes, rates, one writer per variable, pause and start."""

from itertools import pairwise

import pytest
from waiting import wait_until

from client import read_recipe
from urproto.errors import RobotRefused
from urproto.modes import RobotMode, SafetyMode
from urproto.rtde.fields import INPUT_FIELDS, OUTPUT_FIELDS, available_fields

REGISTER = "input_int_register_24"


def steps_s(rtde, count=20):
    stamps = [rtde.receive()["timestamp"] for _ in range(count)]
    return [after - before for before, after in pairwise(stamps)]


def test_the_version_agrees_with_the_dashboard(robot):
    with robot.rtde(["timestamp"]) as rtde:
        version = rtde.core.version
    assert (version.major, version.minor, version.bugfix) == (
        robot.version.major,
        robot.version.minor,
        robot.version.bugfix,
    )


@pytest.mark.parametrize("divisor", [1, 2, 4, 10])
def test_states_arrive_at_the_requested_interval(robot, divisor):
    frequency_hz = robot.version.series.frequency_hz / divisor
    with robot.rtde(["timestamp"], frequency_hz=frequency_hz) as rtde:
        assert rtde.core.rate_hz == pytest.approx(robot.version.series.frequency_hz / divisor)
        expected_s = divisor * robot.period_s
        assert steps_s(rtde) == pytest.approx([expected_s] * 19, abs=robot.period_s / 10)


def test_every_output_of_the_version(robot):
    """Those whose first version is certain; a robot may have more."""
    names = list(available_fields(OUTPUT_FIELDS, robot.version))
    for start in range(0, len(names), 60):  # the guide supports 2048 bytes of names
        with robot.rtde(names[start : start + 60], ignore_unavailable=True) as rtde:
            state = rtde.receive()
            assert set(state) | rtde.core.unavailable == set(names[start : start + 60])
            assert len(rtde.core.unavailable) < len(state) / 4


def test_outputs_missing_in_the_version(robot):
    missing = [name for name, field in OUTPUT_FIELDS.items() if not field.available.covers(robot.version)]
    if not missing:
        pytest.skip("this version has every known output")
    with pytest.raises(RobotRefused, match=f"{missing[0]}: NOT_FOUND"), robot.rtde(["timestamp", missing[0]]):
        pytest.fail("agreed on a variable that is not there")
    with robot.rtde(["timestamp", missing[0]], ignore_unavailable=True) as rtde:
        assert set(rtde.receive()) == {"timestamp"}
        assert rtde.core.unavailable == {missing[0]}


def test_values_are_plausible(robot):
    names = ["robot_mode", "safety_mode", "actual_q", "target_speed_fraction", "speed_scaling", "actual_main_voltage"]
    with robot.rtde(names) as rtde:
        state = rtde.receive()
    assert state["robot_mode"] in list(RobotMode)
    assert state["safety_mode"] in list(SafetyMode)
    assert len(state["actual_q"]) == 6
    assert all(abs(q) < 6.34 for q in state["actual_q"])  # rad: 363 degrees
    assert 0.0 <= state["target_speed_fraction"] <= 1.0
    assert 40.0 < state["actual_main_voltage"] < 56.0  # V, nominally 48


def test_pause_and_resume(robot):
    with robot.rtde(["timestamp"]) as rtde:
        before = rtde.receive()["timestamp"]
        rtde.pause()
        with robot.rtde(["timestamp"]) as other:
            paused_until = wait_until(other, lambda state: state["timestamp"] > before + 0.3)["timestamp"]
        rtde.resume()
        assert rtde.receive()["timestamp"] > paused_until - robot.period_s
        assert steps_s(rtde) == pytest.approx([robot.period_s] * 19, abs=robot.period_s / 10)


def test_the_latest_state_is_new(robot):
    with robot.rtde(["timestamp"]) as slow, robot.rtde(["timestamp"]) as fast:
        slow.receive()
        now = wait_until(fast, lambda state: state["timestamp"] > slow.core.state["timestamp"] + 0.5)["timestamp"]
        assert slow.latest()["timestamp"] > now - 0.25  # s; connections may lag
        assert slow.core.skipped > 0.2 / robot.period_s


def test_one_writer_per_variable(robot):
    with robot.rtde([], [[REGISTER]]) as first:
        with pytest.raises(RobotRefused, match=f"{REGISTER}: IN_USE"), robot.rtde([], [[REGISTER]]):
            pytest.fail("two clients write one variable")
        first.close()
    with robot.rtde(["timestamp"], [[REGISTER]]) as again:  # released with the connection
        again.receive()


def test_several_input_recipes_and_a_file(robot, tmp_path):
    path = tmp_path / "inputs.txt"
    path.write_text("input_double_register_24\ninput_double_register_25\n")
    assert len(read_recipe(path)) == 2
    with robot.rtde(["timestamp"], [[REGISTER], path, ["speed_slider_mask", "speed_slider_fraction"]]) as rtde:
        rtde.receive()


def test_unknown_inputs(robot):
    missing = [name for name, field in INPUT_FIELDS.items() if not field.available.covers(robot.version)]
    if not missing:
        pytest.skip("this version has every known input")
    with pytest.raises(RobotRefused, match="NOT_FOUND"), robot.rtde([], [[missing[0]]]):
        pytest.fail("agreed on a variable that is not there")


def test_reconnecting(robot):
    with robot.rtde(["timestamp"], [[REGISTER]], frequency_hz=25) as rtde:
        before = rtde.receive()["timestamp"]
        rtde.close()
        rtde.reconnect()
        assert rtde.receive()["timestamp"] > before
        assert rtde.core.rate_hz == pytest.approx(25, rel=0.1)
