"""The hardware interface over a driver that only takes notes."""

import asyncio
import math
import re
from itertools import pairwise
from math import inf, nan

import pytest

from client.controllers.configuration import usual_controllers
from client.controllers.goals import ErrorCode, GoalStatus, JointTrajectory, JointTrajectoryPoint
from client.controllers.manager import ControllerManager
from client.controllers.ur_hardware import URHardware
from client.errors import ControllerError, LateSetpointError, ProgramEndedError
from tests.rows import each_row
from urproto.external_control import SplineType, TrajectoryResult, to_words
from urproto.joints import JOINT_NAMES
from urproto.modes import RobotMode, RuntimeState, SafetyMode
from urproto.robots.pose import wrench_trans
from urproto.versions import PolyscopeVersion

PERIOD_S = 0.002
REST = (0.0,) * 6
SCALED = "scaled_joint_trajectory_controller"
PRIMITIVES = "motion_primitive_forward_controller"


class Notes:
    """Stands for URDriver: every call is noted, in order."""

    def __init__(self):
        self.calls = []
        self.program_running = True
        self.loss_reason = ""
        self.link = self
        self.ends = TrajectoryResult.SUCCESS

    def __getattr__(self, name):
        def note(*given, **named):
            self.calls.append((name, *given, *named.values()))

        return note

    async def _later(self, name, *given):
        self.calls.append((name, *given))

    async def send_script(self, text):
        await self._later("send_script", text)

    async def set_speed_slider(self, fraction):
        await self._later("set_speed_slider", fraction)

    async def set_payload(self, *given):
        await self._later("set_payload", *given)

    async def set_target_payload(self, *given):
        await self._later("set_target_payload", *given)

    async def execute(self, points):
        await self._later("execute", points)
        if isinstance(self.ends, Exception):
            raise self.ends
        return self.ends

    def named(self, name):
        return [call[1:] for call in self.calls if call[0] == name]


class Arm:
    """A manager over such a driver, and the state that the robot is said to be in."""

    def __init__(self, version="5.12", prefix=""):
        self.driver = Notes()
        self.tasks = []
        self.hardware = URHardware(self.driver, PolyscopeVersion.parse(version), self._spawn, prefix=prefix)
        self.manager = ControllerManager(self.hardware, usual_controllers(prefix), 1 / PERIOD_S, prefix)
        self.state = {
            "timestamp": 50.0,
            "actual_q": REST,
            "actual_qd": REST,
            "speed_scaling": 1.0,
            "target_speed_fraction": 1.0,
            "safety_mode": SafetyMode.NORMAL,
            "robot_mode": RobotMode.RUNNING,
            "runtime_state": RuntimeState.PLAYING,
        }
        self.cycle()

    def _spawn(self, work):
        task = asyncio.get_running_loop().create_task(work)
        self.tasks.append(task)
        return task

    def cycle(self, count=1, **changes):
        self.state.update(changes)
        for _ in range(count):
            self.state["timestamp"] = round(self.state["timestamp"] + PERIOD_S, 6)
            self.manager.cycle(self.state, self.state["timestamp"], PERIOD_S)

    async def settle(self, count=1):
        """Cycles, with what they begin carried out."""
        for _ in range(count):
            self.cycle()
            await asyncio.gather(*self.tasks, return_exceptions=True)

    @property
    def factor(self):
        return self.hardware.states["speed_scaling/speed_scaling_factor"]


def goal(q, time_s=1.0):
    return JointTrajectory(JOINT_NAMES, (JointTrajectoryPoint(tuple(q), REST, time_from_start_s=time_s),))


def test_read_then_update_then_write():
    arm = Arm()
    arm.manager.activate("forward_position_controller")
    arm.cycle(actual_q=(0.1,) * 6)
    assert arm.driver.named("servoj")[-1][0] == list(REST)  # holds where it stood
    arm.manager.controller("forward_position_controller").command([0.2] * 6)
    arm.cycle()
    assert arm.driver.named("servoj")[-1] == ([0.2] * 6, 0.2)
    arm.manager.deactivate("forward_position_controller")
    assert arm.driver.calls[-1] == ("idle",)


@each_row(
    ("first", "second", "words"),
    [
        (SCALED, "forward_velocity_controller", "position and velocity"),
        (SCALED, "passthrough_trajectory_controller", "position and trajectory_passthrough"),
        (SCALED, PRIMITIVES, "motion_primitive and position"),
        ("passthrough_trajectory_controller", PRIMITIVES, "motion_primitive and trajectory_passthrough"),
        (PRIMITIVES, "freedrive_mode_controller", "freedrive_mode and motion_primitive"),
        (SCALED, "force_mode_controller", "force_mode and position"),
        (SCALED, "freedrive_mode_controller", "freedrive_mode and position"),
        ("passthrough_trajectory_controller", "freedrive_mode_controller", "freedrive_mode and trajectory_passthrough"),
        ("force_mode_controller", "freedrive_mode_controller", "force_mode and freedrive_mode"),
        ("force_mode_controller", "tool_contact_controller", "force_mode and tool_contact"),
        ("forward_effort_controller", None, "5.23"),
    ],
)
def test_modes_that_exclude_each_other(first, second, words):
    arm = Arm()
    if second is None:
        with pytest.raises(ControllerError, match=words):
            arm.manager.activate(first)
        return
    arm.manager.activate(first)
    with pytest.raises(ControllerError, match=words):
        arm.manager.activate(second)
    arm.manager.deactivate(first)
    with pytest.raises(ControllerError, match=words):
        arm.manager.activate(first, second)


@each_row(
    "names",
    [
        ("passthrough_trajectory_controller", "force_mode_controller"),
        (PRIMITIVES, "force_mode_controller"),
        (PRIMITIVES, "tool_contact_controller"),
        (SCALED, "tool_contact_controller", "io_and_status_controller", "joint_state_broadcaster"),
        ("forward_velocity_controller", "tool_contact_controller"),
        ("passthrough_trajectory_controller", "tool_contact_controller"),
    ],
)
def test_modes_that_go_together(names):
    arm = Arm()
    arm.manager.activate(*names)
    assert len(arm.manager.active()) == len(names)


def test_speeds_and_torques_go_out_every_cycle():
    arm = Arm("5.25.1")
    arm.manager.activate("forward_velocity_controller")
    arm.cycle()
    assert arm.driver.calls[-1] == ("speedj", list(REST), 0.2)
    arm.manager.load("forward_effort_controller")
    arm.manager.configure("forward_effort_controller")
    arm.manager.switch(activate=["forward_effort_controller"], deactivate=["forward_velocity_controller"])
    arm.manager.controller("forward_effort_controller").command([1.0] * 6)
    arm.cycle()
    assert arm.driver.calls[-1] == ("torque", [1.0] * 6, 0.2)
    assert ("idle",) not in arm.driver.calls  # from one mode into the other


def test_a_trajectory_by_torques():
    arm = Arm("5.25.1")
    parameters = {
        "joints": list(JOINT_NAMES),
        "command_interfaces": ["effort"],
        "state_interfaces": ["position", "velocity"],
        "gains": {joint: {"p": 100.0, "d": 10.0, "u_clamp_max": 60.0} for joint in JOINT_NAMES},
    }
    arm.manager.load("torques", "joint_trajectory_controller/JointTrajectoryController", parameters)
    arm.manager.activate("torques")
    q = (0.1, 0.2, 0.3, 0.4, 0.5, 1.0)
    arm.manager.controller("torques").send_goal(JointTrajectory(JOINT_NAMES, (JointTrajectoryPoint(q, REST),)))
    arm.cycle(2, actual_qd=(0.1,) * 6)
    assert arm.driver.named("torque")[-1][0] == pytest.approx([min(100.0 * a - 1.0, 60.0) for a in q])


def test_all_joints_or_none():
    arm = Arm()
    arm.manager.load(
        "one", "forward_command_controller/ForwardCommandController",
        {"joints": ["elbow_joint"], "interface_name": "position"},
    )  # fmt: skip
    with pytest.raises(ControllerError, match="all 6 joints must be commanded in position"):
        arm.manager.activate("one")


@each_row(
    "waiting",
    [
        {"safety_mode": SafetyMode.PROTECTIVE_STOP, "runtime_state": RuntimeState.PAUSED},
        {"safety_mode": SafetyMode.SAFEGUARD_STOP, "runtime_state": RuntimeState.PAUSED},
        {"runtime_state": RuntimeState.PAUSED},
        {"runtime_state": RuntimeState.RESUMING},
    ],
)
def test_a_robot_that_waits_freezes_the_trajectory_and_goes_on_gently(waiting):
    arm = Arm()
    arm.manager.activate(SCALED)
    handle = arm.manager.controller(SCALED).send_goal(goal([1.0] * 6))
    for _ in range(250):
        sent = arm.driver.named("servoj")
        arm.cycle(actual_q=tuple(sent[-1][0]) if sent else REST)
    before = len(arm.driver.named("servoj"))
    stood = tuple(q - 0.05 for q in arm.driver.named("servoj")[-1][0])
    arm.cycle(100, actual_q=stood, actual_qd=(0.0,) * 5 + (-0.1,), **waiting)
    assert len(arm.driver.named("servoj")) == before
    arm.cycle(400, actual_qd=REST)
    assert [call[0] for call in arm.driver.named("servoj")[before:]] == [pytest.approx(stood)]  # when it stands, once
    assert arm.factor == 0.0
    assert arm.manager.controller(SCALED).progress == pytest.approx(0.5, abs=0.01)
    arm.cycle(safety_mode=SafetyMode.NORMAL, runtime_state=RuntimeState.PLAYING)
    assert arm.driver.named("servoj")[-1][0] == pytest.approx(stood, abs=1e-3)
    assert arm.factor == pytest.approx(0.01)
    places = [arm.driver.named("servoj")[-1][0][0]]
    for _ in range(1500):
        arm.cycle(actual_q=tuple(arm.driver.named("servoj")[-1][0]))
        places.append(arm.driver.named("servoj")[-1][0][0])
    assert handle.status is GoalStatus.SUCCEEDED
    assert places[-1] == pytest.approx(1.0, abs=1e-6)
    assert max(abs(b - a) for a, b in pairwise(places)) < 1.8 * PERIOD_S


@each_row(
    ("change", "words"),
    [
        ({"safety_mode": SafetyMode.ROBOT_EMERGENCY_STOP}, "ROBOT_EMERGENCY_STOP: clear the cause"),
        ({"robot_mode": RobotMode.IDLE}, "its mode is IDLE"),
        ({"safety_mode": 99}, "its safety mode is UNKNOWN"),
    ],
)
def test_a_robot_that_cannot_move_ends_the_goal(change, words):
    arm = Arm()
    arm.manager.activate(SCALED)
    handle = arm.manager.controller(SCALED).send_goal(goal([1.0] * 6))
    arm.cycle(10)
    arm.cycle(**change)
    assert (handle.status, handle.result.error_code) == (GoalStatus.ABORTED, ErrorCode.INVALID_GOAL)
    assert words in handle.result.error_string
    with pytest.raises(ControllerError, match=words):
        arm.manager.activate(SCALED)


@pytest.mark.parametrize(("seconds", "survives"), [(5, True), (12, False)])
def test_after_a_protective_stop_the_program_may_be_missing_for_a_while(seconds, survives):
    arm = Arm()
    arm.manager.activate(SCALED)
    handle = arm.manager.controller(SCALED).send_goal(goal([1.0] * 6))
    arm.cycle(100)
    arm.cycle(safety_mode=SafetyMode.PROTECTIVE_STOP, runtime_state=RuntimeState.PAUSED)
    arm.driver.program_running = False
    arm.cycle(safety_mode=SafetyMode.NORMAL, runtime_state=RuntimeState.STOPPED)
    arm.cycle(round(seconds / PERIOD_S))
    assert handle.done is not survives


def test_a_restarted_program_has_its_reported_speed_immediately():
    """The speed scaling rises slowly for goals that waited: with a program that ended, goals ended, too."""
    arm = Arm()
    arm.driver.program_running = False
    arm.cycle(2, runtime_state=RuntimeState.STOPPED)
    assert (arm.factor, bool(arm.hardware.failure)) == (0.0, True)
    arm.driver.program_running = True
    arm.cycle(runtime_state=RuntimeState.PLAYING)
    assert arm.factor == 1.0
    arm.cycle(2, safety_mode=SafetyMode.PROTECTIVE_STOP, runtime_state=RuntimeState.PAUSED)
    arm.cycle(safety_mode=SafetyMode.NORMAL, runtime_state=RuntimeState.PLAYING)
    assert 0.0 < arm.factor < 0.1


def test_late_setpoints_are_no_end_of_a_goal(monkeypatch):
    """The robot has stopped the arm, and its program goes on: it comes back to the path as after a pause."""
    arm = Arm()
    arm.manager.activate(SCALED)
    handle = arm.manager.controller(SCALED).send_goal(goal([1.0] * 6))
    arm.cycle(100)
    servoj, stood = arm.driver.servoj, []

    def late(q, timeout_s):
        monkeypatch.setattr(arm.driver, "servoj", servoj, raising=False)
        raise LateSetpointError("a stream of setpoints", "this machine sent no setpoint for 300 ms")

    arm.driver.servoj = late
    arm.cycle(2, actual_q=(0.01,) * 6)
    stood = [call for call in arm.driver.calls if call[0] == "servoj"]
    assert stood[-1][1] == pytest.approx([0.01] * 6, abs=1e-3)
    assert arm.hardware.states.lend(["speed_scaling/speed_scaling_factor"]).get()[0] < 0.1
    assert not handle.done


def test_the_reason_of_a_program_that_was_lost():
    arm = Arm()
    arm.manager.activate(SCALED)
    arm.driver.program_running, arm.driver.loss_reason = False, "the robot heard nothing from this machine"
    arm.cycle()
    assert "heard nothing from this machine" in arm.hardware.failure


def test_the_wrench_is_in_the_frame_of_the_tcp():
    force, pose, offset = (1.0, 2.0, 3.0, 0.1, 0.2, 0.3), (0.3, 0.2, 0.1, 0.0, math.pi, 0.0), (0, 0, 0.1, 0, 0, 0)
    names = [f"tcp_fts_sensor/{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz"]
    for version, wanted in (
        ("3.15", wrench_trans((0, 0, 0, 0, math.pi, 0), force)),
        ("5.12", wrench_trans((0, 0, 0.1, 0, 0, 0), wrench_trans((0, 0, 0, 0, math.pi, 0), force))),
    ):
        arm = Arm(version)
        arm.cycle(actual_TCP_force=force, target_TCP_pose=pose, tcp_offset=offset)
        assert arm.hardware.states.lend(names).get() == pytest.approx(list(wanted))


def test_states_have_the_names_of_ros():
    arm = Arm(prefix="left_")
    arm.manager.activate("joint_state_broadcaster", "tcp_pose_broadcaster", "force_torque_sensor_broadcaster")
    arm.manager.activate("ur_configuration_controller")
    arm.cycle(
        actual_q=(1, 2, 3, 4, 5, 6),
        actual_TCP_pose=(0.1, 0.2, 0.3, 0.0, 0.0, math.pi / 2),
        actual_TCP_force=(0, 0, 5.0, 0, 0, 0),
        target_TCP_pose=(0.1, 0.2, 0.3, 0.0, 0.0, 0.0),
        actual_digital_input_bits=0b101,
    )
    joints = arm.manager.controller("joint_state_broadcaster").topic.latest
    assert joints.name == tuple(f"left_{joint}" for joint in JOINT_NAMES)
    assert joints.position == (1, 2, 3, 4, 5, 6)
    pose = arm.manager.controller("tcp_pose_broadcaster").topic.latest
    assert (pose.frame_id, pose.position) == ("left_base", (0.1, 0.2, 0.3))
    assert pose.orientation == pytest.approx((0, 0, math.sqrt(0.5), math.sqrt(0.5)))
    assert arm.manager.controller("force_torque_sensor_broadcaster").topic.latest.force == pytest.approx((0, 0, 5))
    assert [arm.hardware.states[f"left_gpio/digital_input_{pin}"] for pin in range(3)] == [1.0, 0.0, 1.0]
    assert arm.manager.controller("ur_configuration_controller").robot_software_version()[:2] == (5, 12)


def spline(q, qd=REST, qdd=(), time_s=1.0):
    return JointTrajectoryPoint(tuple(q), tuple(qd), tuple(qdd), time_from_start_s=time_s)


@each_row(
    ("ends", "status"),
    [
        (TrajectoryResult.SUCCESS, GoalStatus.SUCCEEDED),
        (TrajectoryResult.FAILURE, GoalStatus.ABORTED),
        (TrajectoryResult.CANCELED, GoalStatus.ABORTED),
        (ProgramEndedError(50003, "a trajectory"), GoalStatus.ABORTED),
    ],
)
async def test_passthrough_hands_over_splines_and_the_result(ends, status):
    arm = Arm()
    arm.driver.ends = ends
    arm.manager.activate("passthrough_trajectory_controller")
    q = [(0.1 * joint, 0.2 * joint) for joint in range(6)]
    points = (spline([a for a, _ in q], time_s=0.5), spline([b for _, b in q], time_s=0.8))
    handle = arm.manager.controller("passthrough_trajectory_controller").send_goal(JointTrajectory(JOINT_NAMES, points))
    arm.cycle(actual_q=tuple(b for _, b in q))
    await arm.settle(12)
    ((sent,),) = arm.driver.named("execute")
    assert [point.target for point in sent] == [tuple(a for a, _ in q), tuple(b for _, b in q)]
    assert [point.duration_s for point in sent] == pytest.approx([0.5, 0.3])
    assert {point.spline_type for point in sent} == {SplineType.CUBIC}
    assert handle.status is status
    await arm.settle(5)  # and it is ready for the next one
    arm.driver.ends = TrajectoryResult.SUCCESS
    quintic = JointTrajectory(JOINT_NAMES, (spline(REST, REST, REST),))
    again = arm.manager.controller("passthrough_trajectory_controller").send_goal(quintic)
    await arm.settle(10)
    assert again.status is GoalStatus.SUCCEEDED
    assert arm.driver.named("execute")[-1][0][0].spline_type is SplineType.QUINTIC


async def test_settings_reach_the_driver():
    arm = Arm()
    arm.manager.activate("io_and_status_controller", "gravity_update_controller")
    io = arm.manager.controller("io_and_status_controller")
    calls = [
        io.set_digital_out(3, True),
        io.set_digital_out(17, False),
        io.set_analog_out(0, 0.25, voltage=False),
        io.set_payload(1.0, (0, 0, 0.1)),
        io.set_payload(2.0, (0, 0, 0.1), (1, 2, 3, 4, 5, 6), 0.5),
        io.set_speed_slider(0.4),
    ]
    arm.cycle(actual_digital_output_bits=1 << 3, target_speed_fraction=0.4)
    await arm.settle(30)
    assert [call.success for call in calls] == [True] * len(calls)
    texts = [text for (text,) in arm.driver.named("send_script")]
    assert "set_standard_digital_out(3, True)" in texts[0]
    assert "set_tool_digital_out(1, False)" in texts[1]
    assert "set_analog_outputdomain(0, 0)\n  set_standard_analog_out(0, 0.25)" in texts[2]
    assert arm.driver.named("set_payload") == [(1.0, [0, 0, 0.1])]
    assert arm.driver.named("set_target_payload") == [(2.0, [0, 0, 0.1], [1, 2, 3, 4, 5, 6], 0.5)]
    assert arm.driver.named("set_speed_slider") == [(0.4,)]


async def test_settings_fail_at_once_while_the_robot_is_silent():
    arm = Arm()
    arm.manager.activate("io_and_status_controller")
    io = arm.manager.controller("io_and_status_controller")
    arm.cycle()
    begun = io.set_digital_out(3, True)
    arm.cycle()
    assert (io.program_running.latest, begun.success) == (True, None)
    arm.manager.fall_silent("the robot sends nothing")
    assert (io.program_running.latest, begun.success) == (False, False)
    with pytest.raises(ControllerError, match="digital output 3: the robot sends nothing"):
        io.set_digital_out(3, True)
    arm.cycle()
    assert io.program_running.latest is True
    assert io.set_digital_out(3, True).success is None


async def test_a_setting_without_effect_is_no_success():
    arm = Arm()
    arm.manager.activate("io_and_status_controller")
    call = arm.manager.controller("io_and_status_controller").set_digital_out(3, True)
    arm.cycle(actual_digital_output_bits=0)
    await arm.settle(5)
    assert call.success is None
    arm.cycle(round(2.1 / PERIOD_S))
    assert call.success is False
    assert "no effect was seen" in call.message


def test_force_mode_and_freedrive_end_with_their_controllers():
    arm = Arm()
    arm.manager.activate("force_mode_controller")
    arm.manager.deactivate("force_mode_controller")
    assert arm.driver.calls[-1] == ("end_force_mode",)
    arm.manager.activate("freedrive_mode_controller")
    arm.manager.deactivate("freedrive_mode_controller")
    assert ("stop_freedrive",) in arm.driver.calls


async def test_force_mode_parameters():
    arm = Arm()
    arm.manager.activate("force_mode_controller")
    controller = arm.manager.controller("force_mode_controller")
    call = controller.start_force_mode(
        (1, 2, 3, 4, 5, 6), (0, 0, 1, 0, 0, 0), (0, 0, -10, 0, 0, 0),
        speed_limits=(0.1,) * 6, deviation_limits=(0.01,) * 6, damping_factor=0.1, gain_scaling=0.8,
    )  # fmt: skip
    await arm.settle(3)
    assert call.success is True
    (sent,) = arm.driver.named("start_force_mode")
    limits = [0.01, 0.01, 0.1, 0.01, 0.01, 0.01]
    assert sent == ([1, 2, 3, 4, 5, 6], [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], 2, limits, 0.1, 0.8)
    for wrong in ({"type": 4}, {"damping_factor": 1.5}, {"speed_limits": (-1,) * 6}, {"speed_limits": (1,)}):
        with pytest.raises(ControllerError):
            controller.start_force_mode(REST, (1,) * 6, REST, **wrong)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"actual_q": (nan, *REST[1:])}, r"actual_q is \(nan, 0\.0.*, which no arm has"),
        ({"actual_qd": (*REST[1:], -inf)}, r"actual_qd is "),
        ({"actual_qd": REST[1:]}, r"actual_qd has 5 numbers instead of 6"),
        ({"actual_TCP_pose": (0.0, 0.0, 0.0, 1e200, 1e200, 0.0)}, r"actual_TCP_pose is "),
        ({"actual_TCP_force": REST, "target_TCP_pose": (0.0, nan, 0.0, 0.0, 0.0, 0.0)}, r"target_TCP_pose is "),
        ({"actual_TCP_force": (1e308,) * 6, "target_TCP_pose": REST}, r"actual_TCP_force is "),
        ({"tcp_offset": (*REST[1:], inf)}, r"tcp_offset is "),
        ({"payload_cog": (0.0, nan, 0.0)}, r"payload_cog is "),
        ({"speed_scaling": nan}, r"speed_scaling is nan, which no arm has"),
        ({"target_speed_fraction": -1e18}, r"target_speed_fraction is -1e\+18"),
        ({"tool_temperature": inf}, r"tool_temperature is inf"),
        ({"timestamp": nan}, r"timestamp is nan, which is not a time"),
        ({"timestamp": 1e300}, r"timestamp is 1e\+300"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_a_state_that_no_arm_is_in_ends_motion_names_the_field_and_is_not_read(caplog, change, why):
    arm = Arm()
    arm.manager.activate(SCALED, "io_and_status_controller")
    arm.cycle(2)
    before, time_s = arm.hardware.states.get(), arm.manager.time_s
    good = dict(arm.state)
    for _ in range(3):
        stamp = change.get("timestamp", 60.0)
        assert not arm.manager.cycle(arm.state | {"timestamp": stamp} | change, stamp, PERIOD_S)
    warned = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert len(warned) == 1
    assert re.match(f"a state of the robot cannot be used: {why}", warned[0]), warned
    assert [one.name for one in arm.manager.active()] == ["io_and_status_controller"]
    assert [*map(repr, arm.hardware.states.get())] == [*map(repr, before)]
    assert arm.manager.time_s == time_s
    arm.state = good
    arm.cycle()
    arm.manager.activate(SCALED)


def test_what_a_controller_of_ours_does_wrong_is_not_taken_for_a_state_that_is():
    arm = Arm()
    arm.hardware._scale = lambda state, period_s: 1 / 0
    with pytest.raises(ZeroDivisionError):
        arm.cycle()


def test_a_controller_whose_commands_cannot_be_sent_is_ended_by_name(caplog):
    arm = Arm()
    arm.manager.activate("forward_velocity_controller")
    arm.driver.speedj = lambda speeds, _: to_words(speeds)
    arm.manager.controller("forward_velocity_controller").command([9e9, *REST[1:]])
    arm.cycle(2)
    assert not arm.manager.active()
    assert arm.driver.calls[-1] == ("idle",)
    assert "the command cannot be sent: 9000000000.0 cannot be sent" in caplog.text
    arm.cycle()
    arm.manager.activate("forward_velocity_controller")
    arm.cycle(10)
    assert arm.manager.active(), "it is as before"
