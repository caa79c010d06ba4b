"""The controller manager and the services of controllers, for a plain rclpy program in another process."""

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from driver_rig import HOME
from ros2_requests import BEST_EFFORT, STRICT, SWITCH, TRIGGER, begin, mentions, only, q, states, until
from ros2_rig import HOST, SCALED, Lab

from client.controllers.remote import RemoteManager
from client.ros2 import topics
from tests.rows import each_row
from urproto.compat_asyncio import timeout
from urproto.joints import JOINT_NAMES

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.xdist_group("ros2")]


@each_row(("mode", "published"), [(0, True), (7, True), (127, True), (-1, False), (128, False), (10**6, False)])
async def test_a_mode_that_no_controller_has_is_not_published(mode: int, published: bool) -> None:
    message = SimpleNamespace(mode=None)
    assert topics._mode(message, mode, topics.PublishingContext()) is published
    assert message.mode == (mode if published else None)


async def test_controllers_are_switched_as_a_whole_or_not_at_all(lab: Lab) -> None:
    answer = await lab.peer.call(
        "/controller_manager/switch_controller",
        SWITCH,
        activate_controllers=["forward_velocity_controller"],
        strictness=STRICT,
    )
    assert not answer["ok"]
    assert mentions(answer, "position and velocity")
    assert (await states(lab))[SCALED] == "active"
    await only(lab, "forward_velocity_controller")
    now = await states(lab)
    assert (now[SCALED], now["forward_velocity_controller"]) == ("inactive", "active")
    turning = {"data": [0.0, 0.0, 0.0, 0.0, 0.0, 0.2]}
    async with timeout(60.0):  # the first message may be lost, while both sides still meet
        while q(lab)[5] < HOME[5] + 0.05:
            await lab.peer.request(
                publish="/forward_velocity_controller/commands", type="std_msgs/msg/Float64MultiArray", message=turning
            )
    await only(lab)
    assert not await begin(lab, SCALED, HOME, 1.0)


async def test_unknown_controllers(lab: Lab) -> None:
    request = {"activate_controllers": ["knee_controller"]}
    answer = await lab.peer.call("/controller_manager/switch_controller", SWITCH, **request, strictness=STRICT)
    assert not answer["ok"]
    assert mentions(answer, "knee_controller")
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
    assert f"/{name}" in (await lab.peer.graph(lambda graph: f"/{name}" in graph["nodes"]))["nodes"]
    assert await do("unload")
    assert name not in await states(lab)
    answer = await lab.peer.call(
        "/controller_manager/unload_controller", "controller_manager_msgs/srv/UnloadController", name=SCALED
    )
    assert not answer["ok"]  # it is active


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
    controller = lab.control.manager.controller(SCALED)
    assert controller.parameters.constraints.goal_time == 0.5
    assert not (await put("joints", type=9, string_array_value=["a"]))["successful"]
    assert not (await put("constraints.goal_time", type=4, string_value="late"))["successful"]
    assert controller.parameters.constraints.goal_time == 0.5
    assert (await put("constraints.goal_time", type=3, double_value=0.0))["successful"]


async def test_shells_without_ros_talk_to_the_same_manager(lab: Lab) -> None:
    """What one side loads, sets and switches, the other has too."""
    get, second = "rcl_interfaces/srv/GetParameters", "second_controller"
    async with RemoteManager(HOST, lab.robot.ports["rtde"]) as shell:
        assert {one["name"]: one["state"] for one in await shell.request("list_controllers")} == await states(lab)
        await shell.request("set_parameters", name=SCALED, parameters={"constraints.goal_time": 0.75})
        answer = await lab.peer.call(f"/{SCALED}/get_parameters", get, names=["constraints.goal_time"])
        assert answer["values"][0]["double_value"] == 0.75
        await shell.request("set_parameters", name=SCALED, parameters={"constraints.goal_time": 0.0})
        kind = "velocity_controllers/JointGroupVelocityController"
        await shell.request("load_controller", name=second, type=kind, parameters={"joints": list(JOINT_NAMES)})
        answer = await lab.peer.call(f"/{second}/get_parameters", get, names=["joints"])  # it has a node
        assert answer["values"][0]["string_array_value"] == list(JOINT_NAMES)
        await shell.request("configure_controller", name=second)
        await shell.request("switch_controller", activate=[second], deactivate=[SCALED])
        assert ((await states(lab))[second], (await states(lab))[SCALED]) == ("active", "inactive")
        await shell.request("switch_controller", activate=[SCALED], deactivate=[second])
        await shell.request("unload_controller", name=second)
        assert second not in await states(lab)
        (component,) = await shell.request("list_hardware_components")
        assert (component["name"], component["state"]) == ("ur5e", "active")


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

    async def set_io(state: float) -> bool:
        answer = await lab.peer.call("/io_and_status_controller/set_io", "ur_msgs/srv/SetIO", fun=1, pin=3, state=state)
        return bool(answer["success"])

    async def diagnosed(name: str) -> dict[str, Any]:
        message = await lab.peer.echo("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", new=True)
        statuses = {one["name"]: one for one in message["status"]}
        assert {one["hardware_id"] for one in message["status"]} == {"ros2_control"}
        found = statuses[f"controller_manager: {name}"]
        return {**found, "values": {one["key"]: one["value"] for one in found["values"]}}

    await only(lab, SCALED)
    before = await states(lab)
    controllers = await diagnosed("Controllers Activity")
    assert (controllers["level"], controllers["message"]) == (0, "Not all controllers are active")
    assert controllers["values"] == {f"{name}.state": state for name, state in before.items()}
    cycle = (await diagnosed("Controller Manager Activity"))["values"]
    assert cycle["update_rate"] == "500"
    assert 0.0 < float(cycle["periodicity.min"]) <= float(cycle["periodicity.average"]) < 500.1
    assert (await go_to(2))["ok"]
    assert await states(lab) == {**before, SCALED: "inactive"}
    while (hardware := await diagnosed("Hardware Components Activity"))["level"] == 0:
        pass
    assert (hardware["message"], hardware["values"]) == (
        "No hardware components are currently active",
        {"ur5e.state": "inactive"},
    )
    assert not await set_io(1.0)
    assert (await go_to(1))["state"]["label"] == "unconfigured"
    assert not lab.control.driver.program_running
    (component,) = (await lab.peer.call("/controller_manager/list_hardware_components", listing))["component"]
    assert not any(one["is_available"] for one in component["state_interfaces"])
    assert not (await go_to(77))["ok"]
    assert (await go_to(3))["ok"]
    await until(lab, lambda now: now == before)  # what moved the arm is back with it
    assert not lab.robot.controller.snapshot.actual_digital_output_bits
    assert await set_io(0.0)


async def test_inputs_and_outputs(lab: Lab) -> None:
    io = "/io_and_status_controller"
    assert (await lab.peer.call(f"{io}/set_io", "ur_msgs/srv/SetIO", fun=1, pin=3, state=1.0))["success"]
    levels = await lab.peer.echo(f"{io}/io_states", "ur_msgs/msg/IOStates", new=True)
    assert [one["pin"] for one in levels["digital_out_states"] if one["state"]] == [3]
    assert (await lab.peer.call(f"{io}/set_io", "ur_msgs/srv/SetIO", fun=1, pin=3, state=0.0))["success"]
    assert (await lab.peer.call(f"{io}/set_io", "ur_msgs/srv/SetIO", fun=4, state=24.0))["success"]
    analog = {"pin": 1, "domain": 1, "state": 0.5}
    assert (await lab.peer.call(f"{io}/set_analog_output", "ur_msgs/srv/SetAnalogOutput", data=analog))["success"]
    for bad in ({"fun": 1, "pin": 99}, {"fun": 2, "pin": 0}, {"fun": 4, "state": 7.0}, {"fun": 3, "state": 1e30},
                *({"fun": fun, "pin": 1, "state": math.nan} for fun in (1, 3, 4)), {"fun": 4, "state": math.inf},
                {"fun": 4, "state": 12.5}):  # fmt: skip
        assert not (await lab.peer.call(f"{io}/set_io", "ur_msgs/srv/SetIO", **bad))["success"], bad
    slider = "ur_msgs/srv/SetSpeedSliderFraction"
    assert (await lab.peer.call(f"{io}/set_speed_slider", slider, speed_slider_fraction=0.5))["success"]
    assert lab.control.driver.state["target_speed_fraction"] == pytest.approx(0.5, abs=1e-3)
    assert not (await lab.peer.call(f"{io}/set_speed_slider", slider, speed_slider_fraction=0.0))["success"]
    assert (await lab.peer.call(f"{io}/set_speed_slider", slider, speed_slider_fraction=1.0))["success"]
    load = {"mass": 1.5, "center_of_gravity": {"x": 0.0, "y": 0.0, "z": 0.05}}
    assert (await lab.peer.call(f"{io}/set_payload", "ur_msgs/srv/SetPayload", **load))["success"]
    assert lab.robot.controller.snapshot.payload == pytest.approx(1.5)
    for mass in (-1.0, math.nan):
        assert not (await lab.peer.call(f"{io}/set_payload", "ur_msgs/srv/SetPayload", mass=mass))["success"]
    assert (await lab.peer.call(f"{io}/zero_ftsensor", TRIGGER))["success"]
    version = await lab.peer.call(
        "/ur_configuration_controller/get_robot_software_version", "ur_msgs/srv/GetRobotSoftwareVersion"
    )
    assert version["major"] == 5


@pytest.mark.long
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
        {"wrench": {"force": {"z": math.inf}}},
        {"task_frame": {"header": {"frame_id": "moon"}, "pose": {"orientation": {"w": 1.0}}}},
        {"task_frame": {"pose": {"orientation": {"w": 0.0}}}},
    ):
        assert not (await lab.peer.call(start, kind, **{**request, **bad}))["success"], bad
