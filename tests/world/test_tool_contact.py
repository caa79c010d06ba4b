"""tool_contact() and its use in programs: back to just before the contact started."""

import pytest

from tests.rows import each_row
from urproto.modes import RuntimeState

SPEED = 0.05  # m/s


def run_out(rig, within_s=20.0):
    rig.until(lambda: rig.controller.programs.state is RuntimeState.PLAYING)
    rig.until(lambda: rig.controller.programs.state is RuntimeState.STOPPED, within_s)
    assert not rig.complaints


def steps(rig, direction):
    rig.program(f"write_output_integer_register(0, tool_contact({direction}))", "sync()")
    run_out(rig)
    return rig.now.output_int_registers[0]


@each_row("model", ["ur3", "ur5e"])
@each_row("stiffness", [5e3, 5e4])
def test_moving_until_contact_and_back_to_its_start(make, model, stiffness):
    """The Script Manual's example: move, check, store where the contact began, stop, go back there."""
    rig = make(model)
    table = rig.table(0.02, stiffness=stiffness)
    rig.program(
        "steps = 0",
        "while steps == 0:",
        f"  speedl([0, 0, {-SPEED}, 0, 0, 0], 0.5, get_steptime())",
        "  steps = tool_contact(direction=get_actual_tcp_speed())",
        "end",
        "q = get_actual_joint_positions_history(steps)",
        "stopl(3)",
        "movel(q)",
    )
    run_out(rig)
    begun = 2.0 / stiffness  # m: a contact starts at a tenth of the threshold of 20 N
    travel = SPEED * rig.controller.period_s
    assert table.pose[2] - begun - 2 * travel < rig.pose[2] < table.pose[2] + 3 * travel


@pytest.mark.parametrize(
    ("direction", "there"),
    [
        ([0, 0, -1, 0, 0, 0], True),
        ([0.3, 0.0, -0.3, 0, 0, 0], True),
        ([0, 0, 1, 0, 0, 0], False),
        ([1, 0, 0, 0, 0, 0], False),
        ([0, 0, 0, 0, 0, 0], True),
        ([0, 0, 0, 1, 0, 0], True),
    ],
)
def test_only_motion_resisted_by_the_contact_counts(rig, direction, there):
    rig.table(-0.004, stiffness=1e4)
    rig.seconds(0.5)
    assert (steps(rig, direction) > 0) is there


def test_a_touch_lighter_than_the_threshold_is_not_a_contact(rig):
    rig.table(-0.001, stiffness=1e4)
    rig.seconds(0.5)
    assert steps(rig, [0, 0, -1, 0, 0, 0]) == 0
    rig.program("write_output_integer_register(0, tool_contact([0, 0, -1, 0, 0, 0], 5))", "sync()")
    run_out(rig)
    assert rig.now.output_int_registers[0] > 0


def test_zero_ftsensor_subtracts_the_present_force(rig):
    table = rig.table(-0.002, stiffness=1e4)
    rig.seconds(0.1)
    rig.program("zero_ftsensor()", "sync()")
    run_out(rig)
    assert rig.now.actual_TCP_force == pytest.approx((0,) * 6)
    rig.world.move("table", (*table.pose[:2], table.pose[2] + 0.001, 0, 0, 0))
    rig.tick(2)
    assert rig.now.actual_TCP_force[2] == pytest.approx(10)
    assert rig.now.ft_raw_wrench[2] == pytest.approx(-30)  # the sensor itself is not zeroed; its z points down


def test_script_functions_report_the_same_force(rig):
    rig.table(-0.002, stiffness=1e4)
    rig.tick(2)
    rig.program(
        "f = get_tcp_force()",
        "write_output_float_register(0, f[2])",
        "write_output_float_register(1, force())",
        "t = get_joint_torques()",
        "write_output_float_register(2, t[1])",
        "sync()",
    )
    run_out(rig)
    assert rig.now.output_double_registers[:2] == pytest.approx((20, 20))
    lever = rig.pose[0]  # of the shoulder, whose axis is -y: an upward force on the left of it
    assert abs(rig.now.output_double_registers[2]) == pytest.approx(abs(20 * lever), rel=1e-6)
