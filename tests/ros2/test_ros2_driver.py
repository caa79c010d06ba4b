"""The ROS 2 driver before a plain rclpy program in another process: one robot for all of them, at its usual speed."""

import asyncio
import json
import math
import os
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from driver_rig import HOME, driver_options, emulator
from ros2_rig import HOST, PATIENCE_S, SCALED, Lab, laboratory

from client.controllers.remote import RemoteManager
from client.errors import ClientError
from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from urproto.compat_asyncio import timeout
from urproto.joints import JOINT_NAMES
from urproto.robots import load_model

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.xdist_group("ros2")]

FOLLOW = "control_msgs/action/FollowJointTrajectory"
SWITCH = "controller_manager_msgs/srv/SwitchController"
LIST = "controller_manager_msgs/srv/ListControllers"
TRIGGER = "std_srvs/srv/Trigger"
UNTIL = "/trajectory_until_node/execute"
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
TRIGGERED, NOT_TRIGGERED = 0, 1
BEST_EFFORT, STRICT = 1, 2
ALL = ("joint_trajectory_controller", SCALED, "forward_position_controller", "forward_velocity_controller",
       "passthrough_trajectory_controller", "freedrive_mode_controller", "force_mode_controller",
       "tool_contact_controller")  # fmt: skip


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def laboratory_() -> AsyncIterator[Lab]:
    async with emulator("ur5e") as robot, laboratory(robot, driver_options(robot)) as lab:
        yield lab


@pytest_asyncio.fixture(loop_scope="module")
async def lab(laboratory_: Lab) -> Lab:
    """With the scaled controller active and the arm where it was in the beginning."""
    lab = laboratory_
    if not lab.driver.robot.driver.program_running:
        assert (await lab.peer.call("/io_and_status_controller/resend_robot_program", TRIGGER))["success"]
    await only(lab, SCALED)
    if max(abs(a - b) for a, b in zip(q(lab), HOME, strict=True)) > 1e-3:
        assert (await follow(lab, SCALED, HOME, 1.0))["status"] == SUCCEEDED
    return lab


def q(lab: Lab) -> tuple[float, ...]:
    return tuple(lab.robot.controller.snapshot.actual_q)


async def only(lab: Lab, *names: str) -> None:
    stop = [name for name in ALL if name not in names]
    answer = await lab.peer.call(
        "/controller_manager/switch_controller",
        SWITCH,
        activate_controllers=list(names),
        deactivate_controllers=stop,
        strictness=BEST_EFFORT,
    )
    assert answer["ok"], answer


def shifted(offset: float, joint: int = 5) -> list[float]:
    return [angle + (offset if place == joint else 0.0) for place, angle in enumerate(HOME)]


def trajectory(*points: tuple[list[float] | tuple[float, ...], float], names: Any = JOINT_NAMES) -> dict[str, Any]:
    def duration(seconds: float) -> dict[str, int]:
        return {"sec": int(seconds // 1), "nanosec": round(seconds % 1 * 1e9)}

    return {
        "joint_names": list(names),
        "points": [
            {"positions": list(positions), "velocities": [0.0] * len(positions), "time_from_start": duration(seconds)}
            for positions, seconds in points
        ],
    }


async def begin(lab: Lab, controller: str, target: Any, seconds: float, **more: Any) -> bool:
    goal = {"trajectory": trajectory((target, seconds)), **more}
    answer = await lab.peer.ask(goal=f"/{controller}/follow_joint_trajectory", type=FOLLOW, request=goal)
    return bool(answer["accepted"])


async def result(lab: Lab, controller: str) -> dict[str, Any]:
    return await lab.peer.ask(result=f"/{controller}/follow_joint_trajectory")


async def follow(lab: Lab, controller: str, target: Any, seconds: float) -> dict[str, Any]:
    assert await begin(lab, controller, target, seconds)
    return await result(lab, controller)


async def states(lab: Lab) -> dict[str, str]:
    answer = await lab.peer.call("/controller_manager/list_controllers", LIST)
    return {one["name"]: one["state"] for one in answer["controller"]}


async def test_nodes_services_and_topics_are_those_of_the_official_driver(lab: Lab) -> None:
    graph = await lab.peer.ask(graph=True)
    assert {
        "/controller_manager", "/robot_state_publisher", "/joint_state_broadcaster", "/io_and_status_controller",
        "/speed_scaling_state_broadcaster", "/force_torque_sensor_broadcaster", "/tcp_pose_broadcaster",
        "/ur_configuration_controller", "/trajectory_until_node", f"/{SCALED}",
    } <= set(graph["nodes"])  # fmt: skip
    for service, kind in (
        ("/controller_manager/list_controllers", LIST),
        ("/controller_manager/set_hardware_component_state", "controller_manager_msgs/srv/SetHardwareComponentState"),
        ("/io_and_status_controller/set_io", "ur_msgs/srv/SetIO"),
        ("/force_mode_controller/start_force_mode", "ur_msgs/srv/SetForceMode"),
    ):
        assert graph["services"][service] == [kind]
    for topic, kind in (
        ("/joint_states", "sensor_msgs/msg/JointState"),
        ("/tf", "tf2_msgs/msg/TFMessage"),
        ("/robot_description", "std_msgs/msg/String"),
        ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
        (f"/{SCALED}/controller_state", "control_msgs/msg/JointTrajectoryControllerState"),
    ):
        assert graph["topics"][topic] == [kind]


async def test_states_of_the_arm_are_published(lab: Lab) -> None:
    state = await lab.peer.echo("/joint_states", "sensor_msgs/msg/JointState", new=True)
    assert tuple(state["name"]) == JOINT_NAMES
    assert state["position"] == pytest.approx(HOME, abs=1e-3)
    assert abs(state["header"]["stamp"]["sec"] - time.time()) < 5.0
    everything = await lab.peer.echo("/dynamic_joint_states", "control_msgs/msg/DynamicJointState")
    assert {"elbow_joint", "gpio", "tcp_pose"} <= set(everything["joint_names"])
    scaling = "/speed_scaling_state_broadcaster/speed_scaling"
    async with timeout(PATIENCE_S):  # the program has just begun, and the robot comes up to speed
        while (await lab.peer.echo(scaling, "std_msgs/msg/Float64", new=True))["data"] != pytest.approx(100.0):
            pass
    running = await lab.peer.echo("/io_and_status_controller/robot_program_running", "std_msgs/msg/Bool", latched=True)
    assert running["data"] is True
    description = await lab.peer.echo("/robot_description", "std_msgs/msg/String", latched=True)
    assert "shoulder_pan_joint" in description["data"]
    frames = await lab.peer.echo("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
    assert {"base", "tool0"} <= {one["child_frame_id"] for one in frames["transforms"]}
    moving = await lab.peer.echo("/tf", "tf2_msgs/msg/TFMessage")
    assert moving["transforms"]


async def test_a_goal_moves_the_arm_and_tells_how_it_goes(lab: Lab) -> None:
    answer = await follow(lab, SCALED, shifted(0.4), 1.5)
    assert (answer["status"], answer["result"]["error_code"]) == (SUCCEEDED, 0)
    assert answer["result"]["error_string"] == "Goal successfully reached!"
    assert answer["told"] > 5
    assert answer["feedback"][0]["joint_names"] == list(JOINT_NAMES)
    assert q(lab) == pytest.approx(shifted(0.4), abs=5e-3)


async def test_the_robot_interpolates_what_passes_through(lab: Lab) -> None:
    await only(lab, "passthrough_trajectory_controller")
    answer = await follow(lab, "passthrough_trajectory_controller", shifted(-0.3), 1.5)
    assert (answer["status"], answer["result"]["error_code"]) == (SUCCEEDED, 0)
    assert q(lab) == pytest.approx(shifted(-0.3), abs=5e-3)


async def test_goals_that_make_no_sense_are_refused_and_move_nothing(lab: Lab) -> None:
    action = f"/{SCALED}/follow_joint_trajectory"
    for bad in (
        trajectory((HOME, 1.0), names=[*JOINT_NAMES[:5], "knee_joint"]),
        trajectory((HOME, 2.0), (HOME, 1.0)),
        trajectory((shifted(math.nan), 1.0)),
        trajectory((shifted(5.0, joint=2), 60.0)),
        trajectory((HOME[:3], 1.0)),
        {},
    ):
        assert not (await lab.peer.ask(goal=action, type=FOLLOW, request={"trajectory": bad}))["accepted"], bad
    assert not await begin(lab, "joint_trajectory_controller", HOME, 1.0)  # it is not active
    assert not await begin(lab, SCALED, HOME, 1.0, path_tolerance=[{"name": "knee_joint", "position": 1.0}])
    assert q(lab) == pytest.approx(HOME, abs=1e-3)


async def test_a_goal_is_canceled(lab: Lab) -> None:
    assert await begin(lab, SCALED, shifted(1.0), 8.0)
    answer = await lab.peer.ask(cancel=f"/{SCALED}/follow_joint_trajectory")
    assert len(answer["goals_canceling"]) == 1
    assert (await result(lab, SCALED))["status"] == CANCELED


async def test_a_goal_is_replaced(lab: Lab) -> None:
    assert await begin(lab, SCALED, shifted(1.0), 8.0)
    first = lab.driver.robot.manager.controller(SCALED).goal
    assert await begin(lab, SCALED, shifted(0.1), 1.0)
    assert (first.result.error_code, first.result.error_string) == (
        -1, "Current goal preempted by new incoming action.",
    )  # fmt: skip
    assert (await result(lab, SCALED))["status"] == SUCCEEDED


async def until_contact(lab: Lab, target: Any, seconds: float, **more: Any) -> bool:
    goal = {"trajectory": trajectory((target, seconds)), **more}
    answer = await lab.peer.ask(goal=UNTIL, type="ur_msgs/action/FollowJointTrajectoryUntil", request=goal)
    return bool(answer["accepted"])


async def test_a_trajectory_until_the_tool_touches_something(lab: Lab) -> None:
    watching = lab.driver.robot.manager.controller("tool_contact_controller")
    assert not await until_contact(lab, shifted(0.4), 2.0)  # nobody watches
    await only(lab, SCALED, "tool_contact_controller")
    assert not await until_contact(lab, shifted(0.4), 2.0, until_type=1)
    assert not await until_contact(lab, HOME[:3], 2.0)
    await settled(lambda: not watching.watching)

    assert await until_contact(lab, shifted(0.4), 1.0)
    answer = await lab.peer.ask(result=UNTIL)
    assert (answer["status"], answer["result"]["error_code"]) == (SUCCEEDED, 0)
    assert answer["result"]["until_condition_result"] == NOT_TRIGGERED
    assert answer["feedback"][0]["joint_names"] == list(JOINT_NAMES)
    assert q(lab) == pytest.approx(shifted(0.4), abs=5e-3)
    await settled(lambda: not watching.watching)

    assert await until_contact(lab, shifted(-1.0), 10.0)
    assert not await until_contact(lab, shifted(0.4), 1.0)  # one at a time
    assert len((await lab.peer.ask(cancel=UNTIL))["goals_canceling"]) == 1
    answer = await lab.peer.ask(result=UNTIL)
    assert answer["status"] == CANCELED
    assert "Trajectory action was canceled." in answer["result"]["error_string"]
    await settled(lambda: not watching.watching)

    assert await until_contact(lab, moved_down(), 10.0)
    lab.robot.controller.external_wrench = (0.0, 0.0, 60.0, 0.0, 0.0, 0.0)
    answer = await lab.peer.ask(result=UNTIL)
    lab.robot.controller.external_wrench = (0.0,) * 6
    assert (answer["status"], answer["result"]["error_code"]) == (SUCCEEDED, 0)
    assert answer["result"]["until_condition_result"] == TRIGGERED
    assert q(lab) != pytest.approx(moved_down(), abs=0.2)
    await settled(lambda: not watching.watching)
    await only(lab, SCALED)


def moved_down() -> list[float]:
    return [angle + (0.4 if place == 1 else 0.0) for place, angle in enumerate(HOME)]


async def settled(condition: Callable[[], bool]) -> None:
    async with timeout(PATIENCE_S):
        while not condition():
            await asyncio.sleep(0.01)


async def test_a_violated_tolerance_aborts(lab: Lab) -> None:
    tight = [{"name": "wrist_3_joint", "position": 1e-6}]
    assert await begin(lab, SCALED, shifted(1.0), 1.5, path_tolerance=tight)
    answer = await result(lab, SCALED)
    assert (answer["status"], answer["result"]["error_code"]) == (ABORTED, -4)


async def test_controllers_are_switched_as_a_whole_or_not_at_all(lab: Lab) -> None:
    answer = await lab.peer.call(
        "/controller_manager/switch_controller",
        SWITCH,
        activate_controllers=["forward_velocity_controller"],
        strictness=STRICT,
    )
    assert not answer["ok"]
    assert "position and velocity" in answer["message"]
    assert (await states(lab))[SCALED] == "active"
    await only(lab, "forward_velocity_controller")
    now = await states(lab)
    assert (now[SCALED], now["forward_velocity_controller"]) == ("inactive", "active")
    turning = {"data": [0.0, 0.0, 0.0, 0.0, 0.0, 0.2]}
    async with timeout(60.0):  # the first message may be lost, while both sides still meet
        while q(lab)[5] < HOME[5] + 0.05:
            await lab.peer.ask(
                publish="/forward_velocity_controller/commands", type="std_msgs/msg/Float64MultiArray", message=turning
            )
    await only(lab)
    assert not await begin(lab, SCALED, HOME, 1.0)


async def test_unknown_controllers(lab: Lab) -> None:
    request = {"activate_controllers": ["knee_controller"]}
    answer = await lab.peer.call("/controller_manager/switch_controller", SWITCH, **request, strictness=STRICT)
    assert not answer["ok"]
    assert "knee_controller" in answer["message"]
    answer = await lab.peer.call("/controller_manager/switch_controller", SWITCH, **request, strictness=BEST_EFFORT)
    assert answer["ok"]
    load = "controller_manager_msgs/srv/LoadController"
    assert not (await lab.peer.call("/controller_manager/load_controller", load, name="knee_controller"))["ok"]
    assert not (await lab.peer.call("/controller_manager/load_controller", load))["ok"]


async def test_a_controller_of_ones_own_is_loaded_and_unloaded(lab: Lab, tmp_path: Path) -> None:
    """As ``ros2 control load_controller mine --param-file`` does it, and the spawner."""
    name = "mine"
    file = tmp_path / "mine.yaml"
    file.write_text(f"{name}: {{ros__parameters: {{joints: {json.dumps(JOINT_NAMES)}, interface_name: velocity}}}}\n")
    values = {f"{name}.type": "forward_command_controller/ForwardCommandController", f"{name}.params_file": str(file)}
    answer = await lab.peer.call(
        "/controller_manager/set_parameters",
        "rcl_interfaces/srv/SetParameters",
        parameters=[{"name": key, "value": {"type": 4, "string_value": value}} for key, value in values.items()],
    )
    assert all(one["successful"] for one in answer["results"]), answer

    async def do(verb: str) -> bool:
        kind = f"controller_manager_msgs/srv/{verb.capitalize()}Controller"
        return bool((await lab.peer.call(f"/controller_manager/{verb}_controller", kind, name=name))["ok"])

    assert await do("load")
    assert not await do("load")  # it is already
    assert (await states(lab))[name] == "unconfigured"
    assert await do("configure")
    assert (await states(lab))[name] == "inactive"
    assert f"/{name}" in (await lab.peer.ask(graph=True))["nodes"]
    assert await do("unload")
    assert name not in await states(lab)
    answer = await lab.peer.call(
        "/controller_manager/unload_controller", "controller_manager_msgs/srv/UnloadController", name=SCALED
    )
    assert not answer["ok"]  # it is active


async def test_inputs_and_outputs(lab: Lab) -> None:
    io = "/io_and_status_controller"
    assert (await lab.peer.call(f"{io}/set_io", "ur_msgs/srv/SetIO", fun=1, pin=3, state=1.0))["success"]
    levels = await lab.peer.echo(f"{io}/io_states", "ur_msgs/msg/IOStates", new=True)
    assert [one["pin"] for one in levels["digital_out_states"] if one["state"]] == [3]
    assert (await lab.peer.call(f"{io}/set_io", "ur_msgs/srv/SetIO", fun=1, pin=3, state=0.0))["success"]
    assert (await lab.peer.call(f"{io}/set_io", "ur_msgs/srv/SetIO", fun=4, state=24.0))["success"]
    analog = {"pin": 1, "domain": 1, "state": 0.5}
    assert (await lab.peer.call(f"{io}/set_analog_output", "ur_msgs/srv/SetAnalogOutput", data=analog))["success"]
    for bad in ({"fun": 1, "pin": 99}, {"fun": 2, "pin": 0}, {"fun": 4, "state": 7.0}, {"fun": 3, "state": 1e30}):
        assert not (await lab.peer.call(f"{io}/set_io", "ur_msgs/srv/SetIO", **bad))["success"], bad
    slider = "ur_msgs/srv/SetSpeedSliderFraction"
    assert (await lab.peer.call(f"{io}/set_speed_slider", slider, speed_slider_fraction=0.5))["success"]
    assert lab.driver.robot.driver.state["target_speed_fraction"] == pytest.approx(0.5, abs=1e-3)
    assert not (await lab.peer.call(f"{io}/set_speed_slider", slider, speed_slider_fraction=0.0))["success"]
    assert (await lab.peer.call(f"{io}/set_speed_slider", slider, speed_slider_fraction=1.0))["success"]
    load = {"mass": 1.5, "center_of_gravity": {"x": 0.0, "y": 0.0, "z": 0.05}}
    assert (await lab.peer.call(f"{io}/set_payload", "ur_msgs/srv/SetPayload", **load))["success"]
    assert lab.robot.controller.snapshot.payload == pytest.approx(1.5)
    assert not (await lab.peer.call(f"{io}/set_payload", "ur_msgs/srv/SetPayload", mass=-1.0))["success"]
    assert (await lab.peer.call(f"{io}/zero_ftsensor", TRIGGER))["success"]
    version = await lab.peer.call(
        "/ur_configuration_controller/get_robot_software_version", "ur_msgs/srv/GetRobotSoftwareVersion"
    )
    assert version["major"] == 5


async def test_force_mode(lab: Lab) -> None:
    start, request = "/force_mode_controller/start_force_mode", {
        "task_frame": {"header": {"frame_id": "tool0"}, "pose": {"orientation": {"w": 1.0}}},
        "selection_vector_z": True,
        "wrench": {"force": {"z": 5.0}},
        "type": 2,
        "speed_limits": {"linear": {"z": 0.1}},
        "deviation_limits": [0.01] * 6,
        "damping_factor": 0.1,
        "gain_scaling": 0.5,
    }  # fmt: skip
    kind = "ur_msgs/srv/SetForceMode"
    assert not (await lab.peer.call(start, kind, **request))["success"]  # it is not active
    await only(lab, "force_mode_controller")
    assert (await lab.peer.call(start, kind, **request))["success"]
    assert (await lab.peer.call("/force_mode_controller/stop_force_mode", TRIGGER))["success"]
    for bad in (
        {"type": 4},
        {"damping_factor": 2.0},
        {"task_frame": {"header": {"frame_id": "moon"}, "pose": {"orientation": {"w": 1.0}}}},
        {"task_frame": {"pose": {"orientation": {"w": 0.0}}}},
    ):
        assert not (await lab.peer.call(start, kind, **{**request, **bad}))["success"], bad


async def test_parameters(lab: Lab) -> None:
    get, set_ = f"/{SCALED}/get_parameters", f"/{SCALED}/set_parameters"
    names = ["joints", "constraints.goal_time", "constraints.elbow_joint.trajectory"]
    answer = await lab.peer.call(get, "rcl_interfaces/srv/GetParameters", names=names)
    joints, goal_time, path = answer["values"]
    assert joints["string_array_value"] == list(JOINT_NAMES)
    assert (goal_time["double_value"], path["double_value"]) == (0.0, 0.2)

    async def put(name: str, **value: Any) -> dict[str, Any]:
        request = {"parameters": [{"name": name, "value": value}]}
        answer = await lab.peer.call(set_, "rcl_interfaces/srv/SetParameters", **request)
        outcome: dict[str, Any] = answer["results"][0]
        return outcome

    assert (await put("constraints.goal_time", type=3, double_value=0.5))["successful"]
    controller = lab.driver.robot.manager.controller(SCALED)
    assert controller.parameters.constraints.goal_time == 0.5
    assert not (await put("joints", type=9, string_array_value=["a"]))["successful"]
    assert not (await put("constraints.goal_time", type=4, string_value="late"))["successful"]
    assert controller.parameters.constraints.goal_time == 0.5
    assert (await put("constraints.goal_time", type=3, double_value=0.0))["successful"]


async def test_shells_without_ros_talk_to_the_same_manager(lab: Lab) -> None:
    """What one side loads, sets and switches, the other has too."""
    get, second = "rcl_interfaces/srv/GetParameters", "second_controller"
    async with RemoteManager(HOST, lab.robot.ports["rtde"]) as shell:
        assert {one["name"]: one["state"] for one in await shell.ask("list_controllers")} == await states(lab)
        await shell.ask("set_parameters", name=SCALED, parameters={"constraints.goal_time": 0.75})
        answer = await lab.peer.call(f"/{SCALED}/get_parameters", get, names=["constraints.goal_time"])
        assert answer["values"][0]["double_value"] == 0.75
        await shell.ask("set_parameters", name=SCALED, parameters={"constraints.goal_time": 0.0})
        kind = "velocity_controllers/JointGroupVelocityController"
        await shell.ask("load_controller", name=second, type=kind, parameters={"joints": list(JOINT_NAMES)})
        answer = await lab.peer.call(f"/{second}/get_parameters", get, names=["joints"])  # it has a node
        assert answer["values"][0]["string_array_value"] == list(JOINT_NAMES)
        await shell.ask("configure_controller", name=second)
        await shell.ask("switch_controller", activate=[second], deactivate=[SCALED])
        assert ((await states(lab))[second], (await states(lab))[SCALED]) == ("active", "inactive")
        await shell.ask("switch_controller", activate=[SCALED], deactivate=[second])
        await shell.ask("unload_controller", name=second)
        assert second not in await states(lab)
        (component,) = await shell.ask("list_hardware_components")
        assert (component["name"], component["state"]) == ("ur5e", "active")


async def test_the_program_is_lost_and_comes_back(lab: Lab) -> None:
    running = "/io_and_status_controller/robot_program_running"
    assert (await lab.peer.call("/io_and_status_controller/hand_back_control", TRIGGER))["success"]
    while (await lab.peer.echo(running, "std_msgs/msg/Bool", latched=True))["data"]:
        pass
    while (await states(lab))[SCALED] == "active":
        pass
    assert not await begin(lab, SCALED, HOME, 1.0)
    assert (await lab.peer.call("/io_and_status_controller/resend_robot_program", TRIGGER))["success"]
    while not (await lab.peer.echo(running, "std_msgs/msg/Bool", latched=True))["data"]:
        pass
    while (await states(lab))[SCALED] != "active":
        pass
    assert (await follow(lab, SCALED, shifted(0.1), 1.0))["status"] == SUCCEEDED


async def test_the_hardware_component(lab: Lab) -> None:
    listing = "controller_manager_msgs/srv/ListHardwareComponents"
    (component,) = (await lab.peer.call("/controller_manager/list_hardware_components", listing))["component"]
    assert (component["name"], component["state"]["label"]) == ("ur5e", "active")
    assert all(one["is_available"] for one in component["command_interfaces"])

    async def go_to(number: int) -> dict[str, Any]:
        return await lab.peer.call(
            "/controller_manager/set_hardware_component_state",
            "controller_manager_msgs/srv/SetHardwareComponentState",
            name="ur5e",
            target_state={"id": number},
        )

    assert (await go_to(2))["ok"]
    assert (await states(lab))[SCALED] == "inactive"
    assert (await go_to(1))["state"]["label"] == "unconfigured"
    (component,) = (await lab.peer.call("/controller_manager/list_hardware_components", listing))["component"]
    assert not any(one["is_available"] for one in component["state_interfaces"])
    assert not (await go_to(77))["ok"]
    assert (await go_to(3))["ok"]


@pytest.mark.asyncio(loop_scope="function")
async def test_a_robot_that_goes_and_comes_back_finds_the_driver_where_it_was() -> None:
    controller = ControllerConfig(model=load_model("ur3"), initial_q=HOME, running=True)
    address = f"127.17.{os.getpid() % 250 + 1}.{os.getpid() // 250 % 250 + 1}"  # its usual ports, but not everybody's
    config = EmulatorConfig(controller=controller, host=address)
    free = dict.fromkeys(("reverse_port", "sender_port", "trajectory_port", "command_port"), 0)
    async with AsyncExitStack() as first:
        robot = await first.enter_async_context(Emulator(config))
        async with laboratory(robot, {**free, "silence_s": 1.0}, host=address) as lab:
            await until(lab, lambda now: now[SCALED] == "active")
            await first.aclose()
            await until(lab, lambda now: now[SCALED] == "inactive")
            async with Emulator(config):
                await until(lab, lambda now: now[SCALED] == "active")
                assert (await follow(lab, SCALED, shifted(0.1), 1.0))["status"] == SUCCEEDED


@pytest.mark.asyncio(loop_scope="function")
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tf_prefix": "left-"}, "is not a prefix of names"),
        ({"namespace": "1left"}, "does not accept this: Invalid namespace"),
        ({"ros_arguments": ("-p", "nonsense")}, "does not accept this: "),
        ({"controller": "knee_controller"}, "the controllers here are .*scaled_joint_trajectory_controller"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
async def test_options_that_make_no_sense_are_refused_in_words(options: dict[str, Any], words: str) -> None:
    async with emulator("ur3") as robot:
        with pytest.raises(ClientError, match=words):
            async with laboratory(robot, driver_options(robot), **options):
                pass


async def until(lab: Lab, met: Callable[[dict[str, str]], bool]) -> None:
    async with timeout(60.0):
        while not met(await states(lab)):
            pass
