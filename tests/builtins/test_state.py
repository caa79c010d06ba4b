"""Queries and settings of arm and controller in programs."""

import math

import pytest

from tests.rows import each_row
from urproto.modes import RuntimeState
from urproto.robots.pose import pose_trans
from urscript.values import Matrix, Pose

HOME = [0.0, -1.5, 1.5, -1.6, -1.57, 0.0]


def test_positions_and_poses_agree_with_the_snapshot(rig):
    snapshot = rig.controller.snapshot
    assert rig.value("get_actual_joint_positions()") == list(snapshot.actual_q)
    assert rig.value("get_joint_positions()") == list(snapshot.actual_q)
    assert rig.value("get_target_joint_positions()") == list(snapshot.target_q)
    pose = rig.value("get_actual_tcp_pose()")
    assert isinstance(pose, Pose)
    assert list(pose) == pytest.approx(list(snapshot.actual_TCP_pose), abs=1e-12)
    assert rig.value("get_target_tcp_pose()") == pose


def test_the_flange_pose_excludes_the_tcp_offset(rig):
    rig.run("set_tcp(p[0, 0, 0.2, 0, 0, 0])")
    flange, tcp = rig.value("get_actual_tool_flange_pose()"), rig.value("get_actual_tcp_pose()")
    assert list(tcp) == pytest.approx(pose_trans(flange, (0, 0, 0.2, 0, 0, 0)))
    assert rig.value("get_tcp_offset()") == Pose([0, 0, 0.2, 0, 0, 0])


def test_tcp_takes_effect_in_the_same_frame(rig):
    rig.run("a = get_actual_tcp_pose()\nset_tcp(p[0, 0, 0.1, 0, 0, 0])\ntextmsg(point_dist(a, get_actual_tcp_pose()))")
    assert float(rig.texts[0]) == pytest.approx(0.1)


def test_speeds_are_read_during_a_move(rig):
    rig.run(
        """
        speedl([0, 0.1, 0, 0, 0, 0], a=2, t=0.3)
        global tool = get_actual_tcp_speed()
        global joints = get_actual_joint_speeds()
        textmsg(norm([tool[0], tool[1] - 0.1, tool[2]]) < 0.001)
        textmsg(norm(joints) > 0.05)
        textmsg(is_steady())
        stopl(2)
        """
    )
    assert rig.texts == ["True", "True", "False"]
    assert rig.value("is_steady()") is False
    rig.seconds(0.5)
    assert rig.value("is_steady()") is True


def test_accelerations_are_read_during_a_move(rig):
    rig.run(
        """
        thread look():
          sleep(0.1)
          global target = get_target_joint_accelerations()
          global actual = get_actual_joint_accelerations()
        end
        run look()
        movej([0.5, -1.5, 1.5, -1.6, -1.57, 0], a=0.8, v=1)
        textmsg(target == actual)
        textmsg(floor(target[0] * 1000 + 0.5))
        """
    )
    assert rig.texts == ["True", "800"]


def test_the_target_waypoint_is_the_target_of_the_move(rig):
    rig.run(
        """
        global goal = pose_add(get_actual_tcp_pose(), p[0, 0.1, 0, 0, 0, 0])
        thread look():
          sleep(0.1)
          textmsg(point_dist(get_target_waypoint(), goal) < 1e-9)
        end
        run look()
        movel(goal)
        """
    )
    assert rig.texts == ["True"]


def test_joint_history_returns_earlier_positions(rig):
    rig.run(
        """
        speedj([0.5, 0, 0, 0, 0, 0], 10, 0.5)
        now = get_actual_joint_positions_history(0)
        then = get_actual_joint_positions_history(100)
        global moved = now[0] - then[0]
        textmsg(moved)
        stopj(10)
        """
    )
    assert float(rig.texts[0]) == pytest.approx(0.5 * 100 * rig.period, rel=0.01)
    assert "steps" in rig.fault("get_actual_joint_positions_history(-1)")


def test_inverse_kinematics_is_near_the_seed(rig):
    assert rig.value("get_inverse_kin(get_actual_tcp_pose())") == pytest.approx(HOME, abs=1e-7)
    other = rig.value("get_inverse_kin(get_actual_tcp_pose(), qnear=[0, -0.2, -1.5, -1.2, -1.57, 0])")
    assert other[2] < 0
    reached, wanted = rig.value(f"get_forward_kin({other})"), rig.value("get_actual_tcp_pose()")
    assert list(reached) == pytest.approx(list(wanted), abs=1e-6)


def test_inverse_kinematics_with_another_tcp(rig):
    q = rig.value(f"get_inverse_kin(get_forward_kin({HOME}, p[0,0,0.1,0,0,0]), {HOME}, tcp=p[0,0,0.1,0,0,0])")
    assert q == pytest.approx(HOME, abs=1e-7)


def test_pose_out_of_reach_has_no_solution(rig):
    assert rig.value("get_inverse_kin_has_solution(p[0.4, 0.2, 0.3, 0, 3.14, 0])") is True
    assert rig.value("get_inverse_kin_has_solution(p[10, 0, 0, 0, 0, 0])") is False
    assert "out of reach" in rig.fault("q = get_inverse_kin(p[10, 0, 0, 0, 0, 0])")


@each_row(
    ("argument", "within"),
    [
        ("p[0.4, 0.2, 0.3, 0, 3.14, 0]", True),
        ("p[3, 0, 0, 0, 0, 0]", False),
        ("[0, -1, 1, 0, 0, 0]", True),
        ("[7, -1, 1, 0, 0, 0]", False),
    ],
)
def test_safety_limits_of_poses_and_joints(rig, argument, within):
    assert rig.value(f"is_within_safety_limits({argument})") is within


def test_jacobian_times_speed_is_the_tool_speed(rig):
    jacobian = rig.value("get_jacobian()")
    assert isinstance(jacobian, Matrix)
    assert jacobian.shape == (6, 6)
    step = 1e-6
    moved = [HOME[0] + step, *HOME[1:]]
    a, b = rig.value(f"get_forward_kin({HOME})"), rig.value(f"get_forward_kin({moved})")
    numeric = [(y - x) / step for x, y in zip(a[:3], b[:3], strict=True)]
    assert [jacobian.rows[i][0] for i in range(3)] == pytest.approx(numeric, abs=1e-5)


def test_jacobian_derivative_against_differences(rig):
    qd, step = [0.3, -0.2, 0.1, 0.4, -0.5, 0.6], 1e-6
    derivative = rig.value(f"get_jacobian_time_derivative({HOME}, {qd})")
    later = [q + step * rate for q, rate in zip(HOME, qd, strict=True)]
    a, b = rig.value(f"get_jacobian({HOME})"), rig.value(f"get_jacobian({later})")
    numeric = [[(y - x) / step for x, y in zip(r, s, strict=True)] for r, s in zip(a.rows, b.rows, strict=True)]
    for row, expected in zip(derivative.rows, numeric, strict=True):
        assert list(row) == pytest.approx(expected, abs=1e-4)


def test_mass_matrix_is_symmetric_and_grows_with_payload(rig):
    light = rig.value("get_mass_matrix()")
    for i in range(6):
        for j in range(6):
            assert light.rows[i][j] == pytest.approx(light.rows[j][i], abs=1e-9)
    rig.run("set_target_payload(4, [0, 0, 0.1], [0.01, 0.01, 0.01, 0, 0, 0])")
    assert rig.value("get_mass_matrix()").rows[0][0] > light.rows[0][0] + 0.1
    assert "rotors" in rig.fault("x = get_mass_matrix(include_rotors_inertia=True)")


def test_no_coriolis_torques_at_rest(rig):
    assert rig.value("get_coriolis_and_centrifugal_torques()") == pytest.approx([0] * 6)
    assert max(map(abs, rig.value(f"get_coriolis_and_centrifugal_torques({HOME}, [1, 1, 0, 0, 0, 0])"))) > 0.01


def test_payload_without_centre_of_gravity_is_at_the_tcp(rig):
    rig.run("set_tcp(p[0, 0, 0.15, 0, 0, 0])\nset_payload(1.5)")
    assert rig.controller.snapshot.payload == 1.5
    assert rig.controller.snapshot.payload_cog == (0, 0, 0.15)
    rig.run("set_payload(2, [0.01, 0, 0.05])\nset_payload_mass(3)")
    assert rig.value("get_target_payload()") == 3
    assert rig.value("get_target_payload_cog()") == [0.01, 0, 0.05]
    rig.run("set_payload_cog([0, 0, 0.02])")
    assert rig.controller.snapshot.payload_cog == (0, 0, 0.02)


def test_a_payload_without_centre_of_gravity_follows_the_tcp(rig):
    """Script Manuals CB3 3.15.4 and 5.12: later calls of set_tcp change the centre of gravity too."""
    rig.run("set_payload(1.5)\nset_tcp(p[0, 0, 0.15, 0, 0, 0])\nset_payload_mass(2)")
    assert (rig.controller.snapshot.payload, rig.controller.snapshot.payload_cog) == (2, (0, 0, 0.15))
    rig.run("set_payload(1, [0, 0, 0.02])\nset_tcp(p[0, 0, 0.3, 0, 0, 0])")
    assert rig.controller.snapshot.payload_cog == (0, 0, 0.02)


def test_a_failed_assertion_ends_the_program(rig):
    rig.run('assert(1 == 1)\ntextmsg("fine")')
    assert rig.texts == ["fine"]
    assert rig.fault("assert(1 == 2)") == "assert: the condition is False"


def test_payload_changes_gradually_over_its_transition_time(rig):
    rig.run("set_target_payload(4, [0, 0, 0.1], [0.1, 0.1, 0.1, 0, 0, 0], transition_time=1)\nsleep(0.5)")
    assert rig.controller.snapshot.payload == pytest.approx(2.0, abs=0.05)
    assert rig.value("get_target_payload()") == 4
    rig.seconds(0.6)
    assert rig.controller.snapshot.payload == 4
    assert rig.value("get_target_payload_inertia()") == [0.1, 0.1, 0.1, 0, 0, 0]


@each_row(
    "call",
    [
        "set_payload(-1)",
        "set_payload(1, [0, 0])",
        "set_target_payload(1, [0, 0, 0], [-1, 0, 0, 0, 0, 0])",
        'set_gravity([0, 0, "a"])',
        "set_tcp([0, 0, 0, 0, 0, 0])",
    ],
)
def test_invalid_settings_are_refused(rig, call):
    assert rig.fault(call)


def test_gravity_takes_effect_and_is_read_back(rig):
    rig.run("set_gravity([0, 9.82, 0])")
    assert rig.controller.snapshot.target_gravity == (0, 9.82, 0)
    assert rig.value("get_gravity()") == [0, 9.82, 0]


def test_external_force_is_measured_and_can_be_zeroed(cb3):
    cb3.controller.external_wrench = (3.0, 0.0, 4.0, 0.0, 0.0, 0.0)
    cb3.tick(2)
    assert cb3.value("force()") == pytest.approx(5.0)
    assert cb3.value("get_tcp_force()") == [3, 0, 4, 0, 0, 0]
    assert max(map(abs, cb3.value("get_joint_torques()"))) > 0.5
    cb3.run("zero_ftsensor()")
    assert cb3.value("force()") == pytest.approx(0.0)


def test_a_script_that_a_client_sends_does_not_zero_the_sensor(rig):
    """Only the preamble of a program that the pendant plays sets a payload, which does; see tests/programs."""
    wrench = (3.0, 0.0, 4.0, 0.0, 0.0, 0.0)

    def push():
        rig.controller.external_wrench = wrench

    assert rig.value("force()", meanwhile=push) == pytest.approx(5.0)
    assert rig.value("force()") == pytest.approx(5.0)
    assert rig.controller.snapshot.actual_TCP_force == pytest.approx(wrench)


def test_secondary_programs_and_resumed_programs_do_not_zero_the_sensor(rig):
    rig.start("sleep(5)")
    rig.controller.external_wrench = (3.0, 0.0, 4.0, 0.0, 0.0, 0.0)
    rig.submit("sec beside():\n  set_standard_digital_out(0, True)\nend\n")
    rig.tick(2)
    rig.controller.programs.pause()
    rig.until(lambda: rig.state is RuntimeState.PAUSED, 1.0)
    rig.controller.programs.resume()
    rig.until(lambda: rig.state is RuntimeState.PLAYING, 1.0)
    assert rig.controller.signals.digital_outputs & 1
    assert rig.controller.snapshot.actual_TCP_force[2] == pytest.approx(4.0)


@pytest.mark.parametrize("name", ["ft_rtde_input_enable", "enable_external_ft_sensor"])
def test_force_sensor_can_come_from_rtde(rig, name):
    rig.controller.ft_input.wrench_flange = (0.0, 0.0, 7.0, 0.0, 0.0, 0.0)
    assert rig.value("force()") == 0.0
    rig.run(f"{name}(True, 0.5, [0, 0, 0.03], [0, 0, 0.01])")
    rig.tick()
    assert math.hypot(*rig.controller.snapshot.actual_TCP_force[:3]) == pytest.approx(7.0)
    assert rig.controller.ft_input.sensor_mass == 0.5
    rig.run(f"{name}(False)")
    rig.tick(2)
    assert rig.value("force()") == 0.0


def test_contact_is_detected_against_the_direction_of_motion(rig):
    assert rig.value("tool_contact(direction=[0, 0, -1, 0, 0, 0])") == 0
    rig.start(
        """
        sleep(0.2)
        textmsg(tool_contact(direction=[0, 0, -1, 0, 0, 0]) > 40)
        textmsg(tool_contact([0, 0, 0, 0, 0, 0]) > 40)
        textmsg(tool_contact(direction=[0, 0, 1, 0, 0, 0]))
        textmsg(tool_contact(direction=[1, 0, 0, 0, 0, 0]))
        """
    )
    rig.until(lambda: rig.state is RuntimeState.PLAYING)
    rig.controller.external_wrench = (0.0, 0.0, 40.0, 0.0, 0.0, 0.0)
    rig.until(lambda: rig.state is RuntimeState.STOPPED)
    assert rig.texts == ["True", "True", "0", "0"]


def test_the_threshold_and_the_last_three_numbers_of_a_contact(rig):
    rig.start(
        """
        sleep(0.2)
        textmsg(tool_contact([0, 0, -1, 0, 0, 0]))
        textmsg(tool_contact([0, 0, -1, 0, 0, 0], force_threshold=5) > 40)
        textmsg(tool_contact([0, 0, 0, 1, 0, 0], 5) > 40)
        textmsg(tool_contact([0, 0, -1, 0, 0, 0], 11))
        """
    )
    rig.until(lambda: rig.state is RuntimeState.PLAYING)
    rig.controller.external_wrench = (0.0, 0.0, 10.0, 0.0, 0.0, 0.0)
    rig.until(lambda: rig.state is RuntimeState.STOPPED)
    assert rig.texts == ["0", "True", "True", "0"]
    assert "force_threshold" in rig.fault("tool_contact([0, 0, -1, 0, 0, 0], -1)")


def test_move_until_contact_returns_to_the_first_touch(rig):
    rig.start(
        """
        steps = 0
        while steps <= 0:
          steps = tool_contact(direction=[0, 0, -1, 0, 0, 0])
          speedl([0, 0, -0.05, 0, 0, 0], 0.5, t=get_steptime())
        end
        q = get_actual_joint_positions_history(steps)
        stopl(3)
        movel(q)
        """
    )
    rig.seconds(1.0)
    touched = rig.controller.snapshot.actual_TCP_pose
    rig.controller.external_wrench = (0.0, 0.0, 40.0, 0.0, 0.0, 0.0)
    rig.until(lambda: rig.state.name == "STOPPED", 5.0)
    assert rig.controller.snapshot.actual_TCP_pose == pytest.approx(touched, abs=5e-4)


def test_force_mode_pushes_until_it_ends(rig):
    start = rig.controller.snapshot.actual_TCP_pose
    rig.run(
        """
        force_mode_set_damping(0.1)
        force_mode_set_gain_scaling(0.8)
        force_mode(p[0, 0, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], 2.0, [0.1, 0.1, 0.1, 1, 1, 1])
        sleep(1)
        textmsg(is_steady())
        end_force_mode()
        stopl(5)
        """
    )
    end = rig.controller.snapshot.actual_TCP_pose
    assert end[2] < start[2] - 0.005
    assert end[:2] == pytest.approx(start[:2], abs=1e-4)
    assert rig.texts == ["False"]
    rig.seconds(0.5)
    assert rig.controller.snapshot.actual_TCP_pose == pytest.approx(end, abs=1e-3)


def test_program_end_ends_force_mode(rig):
    rig.run("force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,-10,0,0,0], 2, [0.1,0.1,0.1,1,1,1])\nsleep(0.5)")
    rig.seconds(0.5)
    held = rig.q
    rig.seconds(0.5)
    assert rig.q == held


@each_row(
    "call",
    [
        "force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,1,0,0,0], 4, [1,1,1,1,1,1])",
        "force_mode(p[0,0,0,0,0,0], [0,0,5,0,0,0], [0,0,1,0,0,0], 2, [1,1,1,1,1,1])",
        "force_mode_set_damping(1.5)",
        "force_mode_set_gain_scaling(-1)",
        "freedrive_mode(freeAxes=[1,1,1])",
    ],
)
def test_impossible_force_modes_are_refused(rig, call):
    assert rig.fault(call)


@pytest.mark.parametrize("begin", ["freedrive_mode()", "teach_mode()", "freedrive_mode(freeAxes=[1,1,1,1,1,1])"])
def test_freedrive_follows_the_hand(rig, begin):
    end = "end_teach_mode()" if "teach" in begin else "end_freedrive_mode()"
    rig.start(f"{begin}\ntextmsg(get_freedrive_status())\nsleep(1)\n{end}\nsleep(0.5)")
    start = rig.controller.snapshot.actual_TCP_pose
    rig.controller.external_wrench = (0.0, 20.0, 0.0, 0.0, 0.0, 0.0)
    rig.seconds(1.0)
    assert rig.controller.snapshot.actual_TCP_pose[1] > start[1] + 0.01
    rig.until(lambda: rig.state.name == "STOPPED", 2.0)
    assert rig.texts == ["0"]


@pytest.mark.parametrize(("key", "attribute"), [("target_q", "target_q"), ("output_int_register_3", None)])
def test_rtde_outputs_can_be_read(rig, key, attribute):
    rig.run("write_output_integer_register(3, 17)")
    rig.tick()
    value = rig.value(f'get_rtde_value("{key}")')
    assert value == (list(getattr(rig.controller.snapshot, attribute)) if attribute else 17)
    assert "no RTDE output" in rig.fault('get_rtde_value("nonsense")')


def test_temperatures_currents_and_other_state(rig):
    assert rig.value("get_steptime()") == 0.002
    assert rig.value("get_joint_temp(2)") == rig.controller.snapshot.joint_temperatures[2]
    assert isinstance(rig.value("get_tool_temp()"), float)
    assert isinstance(rig.value("get_tool_current()"), float)
    assert rig.value("get_controller_temp()") == rig.controller.snapshot.board_temperature
    assert math.hypot(*rig.value("get_tool_accelerometer_reading()")) == pytest.approx(9.82, abs=0.01)
    assert "no joint 6" in rig.fault("get_joint_temp(6)")
    uptime = rig.value("time(0)")
    assert uptime.members["sec"] + uptime.members["nanosec"] / 1e9 == pytest.approx(rig.controller.time_s, abs=0.1)


def test_the_step_time_of_cb3(cb3):
    assert cb3.value("get_steptime()") == 0.008


def test_the_revolution_counter_is_reset_only_on_unlimited_wrists(make_rig):
    rig = make_rig("ur3e", None)
    rig.run("movej([0, -1.5, 1.5, -1.6, -1.57, 7], t=3)\nreset_revolution_counter()")
    assert rig.q[5] == pytest.approx(7 - 2 * math.pi, abs=1e-9)
