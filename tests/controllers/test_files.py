"""Controllers files and goal files: what they say, and what is told about the rest."""

import math
from pathlib import Path

import pytest
from typer.testing import CliRunner

from client.cli import app
from client.controllers import configuration
from client.controllers.configuration import read_controllers, usual_controllers
from client.controllers.goal_files import read_goals
from client.controllers.joint_trajectory import Gains
from client.controllers.parameters import Reading, read_parameters
from client.controllers.running import ManagerOptions
from client.errors import ControllerError
from tests.rows import each_row
from urproto.joints import JOINT_NAMES

# the form that ur_robot_driver ships: substitutions, dots, keys only ROS has a use for
CONTROLLERS = """
controller_manager:
  {key}:
    update_rate: 250
    scaled_joint_trajectory_controller:
      type: ur_controllers/ScaledJointTrajectoryController
    forward_velocity_controller:
      type: velocity_controllers/JointGroupVelocityController
      params_file: other.yaml
    hurry: true

scaled_joint_trajectory_controller:
  {key}:
    joints:
      - $(var tf_prefix)shoulder_pan_joint
      - $(var tf_prefix)elbow_joint
    command_interfaces:
      - position
    state_interfaces: [position, velocity]
    state_publish_rate: 30.0
    action_monitor_rate: 30.0
    allow_partial_joints_goal: false
    colour: red
    constraints.goal_time: 2
    constraints:
      stopped_velocity_tolerance: 0.2
      $(var tf_prefix)elbow_joint: {{ trajectory: 0.2, goal: 0.1, colour: blue }}
    speed_scaling_interface_name: $(var tf_prefix)speed_scaling/speed_scaling_factor

/forward_velocity_controller:
  {key}:
    joints: [$(var tf_prefix)elbow_joint]

gripper_controller:
  {key}: {{a: 1}}
"""


def write(tmp_path, text):
    path = tmp_path / "file.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("key", ["ros__parameters", "ros_parameters"])
def test_a_controllers_file(tmp_path, key):
    file = read_controllers(write(tmp_path, CONTROLLERS.format(key=key)), "left_")
    assert file.types["scaled_joint_trajectory_controller"] == "ur_controllers/ScaledJointTrajectoryController"
    assert file.parameters_of("forward_velocity_controller") == {"joints": ["left_elbow_joint"]}
    assert [note.split(" ")[1] for note in file.notes] == [
        "update_rate",
        "forward_velocity_controller.params_file",
        "hurry",
        "section",
    ]
    name = "scaled_joint_trajectory_controller"
    reading = Reading()
    kind = configuration.find(name, file.type_of(name))
    read = read_parameters(kind.parameters_type, file.parameters_of(name), name, reading)
    assert read.joints == ("left_shoulder_pan_joint", "left_elbow_joint")
    assert (read.constraints.goal_time, read.constraints.stopped_velocity_tolerance) == (2.0, 0.2)
    assert read.constraints.joints["left_elbow_joint"].goal == 0.1
    assert read.speed_scaling_interface_name == "left_speed_scaling/speed_scaling_factor"
    assert reading.unknown == ["colour", "constraints.left_elbow_joint.colour"]
    assert [text.split(" ")[0] for text in reading.without_effect] == ["state_publish_rate", "action_monitor_rate"]


@each_row(
    ("kind", "given", "reported"),
    [
        ("joint_trajectory_controller/JointTrajectoryController", {"state_publish_rate": 100.0}, []),
        ("joint_trajectory_controller/JointTrajectoryController", {"action_monitor_rate": 20.0}, []),
        (
            "joint_trajectory_controller/JointTrajectoryController",
            {"action_monitor_rate": 5.0},
            ["action_monitor_rate"],
        ),
        ("joint_trajectory_controller/JointTrajectoryController", {"update_rate": 500}, []),
        ("joint_trajectory_controller/JointTrajectoryController", {"update_rate": 50}, ["update_rate"]),
        ("force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster", {"topic_name": "ft_data"}, []),
        ("force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster", {"topic_name": "force"}, ["topic_name"]),
        ("pose_broadcaster/PoseBroadcaster", {"frame_id": "b", "pose_name": "p", "tf": {"child_frame_id": "t"}}, []),
        (
            "pose_broadcaster/PoseBroadcaster",
            {"frame_id": "b", "pose_name": "p", "tf": {"enable": False}},
            ["tf.enable"],
        ),
    ],
)
def test_values_of_the_official_files_are_not_reported(kind, given, reported):
    """Source of the values: ur_controllers.yaml of the official driver, branches humble to lyrical, July 2026."""
    if "trajectory" in kind:
        given = {**given, "joints": [], "command_interfaces": [], "state_interfaces": []}
    reading = Reading()
    read_parameters(configuration.find("a", kind).parameters_type, given, "a", reading)
    assert [text.split(" ")[0] for text in reading.without_effect] == reported
    assert not reading.unknown


@each_row(
    ("line", "notes"),
    [
        ("update_rate: $(var update_rate)", 0),
        ("update_rate: 100", 1),
        ("enforce_command_limits: false", 0),
        ("enforce_command_limits: true", 1),
    ],
)
def test_lines_of_the_manager_that_change_nothing(tmp_path, line, notes):
    text = f"controller_manager: {{ros__parameters: {{{line}}}}}"
    assert len(read_controllers(write(tmp_path, text)).notes) == notes


@each_row(
    ("names", "chosen"),
    [
        (["joint_trajectory_controller", "scaled_joint_trajectory_controller"], "scaled_joint_trajectory_controller"),
        (["passthrough_trajectory_controller", "joint_trajectory_controller"], "joint_trajectory_controller"),
        (["mine", "forward_position_controller"], "mine"),
        (["forward_position_controller"], ""),
    ],
)
def test_the_files_trajectory_controller_is_the_initial_one(names, chosen):
    kinds = {
        "passthrough_trajectory_controller": "ur_controllers/PassthroughTrajectoryController",
        "forward_position_controller": "position_controllers/JointGroupPositionController",
    }
    types = {name: kinds.get(name, "joint_trajectory_controller/JointTrajectoryController") for name in names}
    assert configuration.trajectory_controller(types) == chosen
    file = configuration.ControllersFile("file", types)
    assert ManagerOptions("robot", {}, file).initial_controller == chosen
    assert ManagerOptions("robot", {}, file, controller="").initial_controller == ""


@each_row("implied", ["position", "velocity", "effort"])
def test_the_older_forward_controllers_imply_their_interface(implied):
    kind = configuration.find("a", f"{implied}_controllers/JointGroup{implied.capitalize()}Controller")
    given = {"joints": ("a_joint",), "interface_name": implied}
    controller = kind("a", read_parameters(kind.parameters_type, given, "a", Reading()), 500.0)
    controller.on_configure()
    assert controller.command_interfaces == (f"a_joint/{implied}",)
    wrong = read_parameters(kind.parameters_type, {**given, "interface_name": "torque"}, "a", Reading())
    with pytest.raises(ControllerError, match=f"commands {implied}: leave interface_name out"):
        kind("a", wrong, 500.0).on_configure()


@each_row(
    ("text", "words"),
    [
        ("a: [", "not YAML"),
        ("- 1", "no sections"),
        ("x: {ros__parameters: {}}", "no section controller_manager"),
        ("controller_manager: {a: 1}", "no ros__parameters"),
        ("controller_manager: {ros__parameters: {a: $(find pkg)/x}}", r"\$\(find pkg\) cannot be substituted"),
        ("controller_manager: {ros__parameters: {a: $(var speed)}}", r"\$\(var speed\) cannot be substituted"),
    ],
)
def test_files_that_are_none(tmp_path, text, words):
    with pytest.raises(ControllerError, match=words):
        read_controllers(write(tmp_path, text))


def test_general_parameters_are_everybodys(tmp_path):
    manager = "controller_manager: {ros__parameters: {x: {type: ur_controllers/GPIOController}}}"
    text = f"/**: {{ros__parameters: {{tf_prefix: a_}}}}\n{manager}"
    assert read_controllers(write(tmp_path, text)).parameters_of("x") == {"tf_prefix": "a_"}


def test_parameters_that_contain_themselves():
    endless = {"joints": ["a"], "interface_name": "position"}
    endless["more"] = {"again": endless}
    kind = configuration.find("x", "forward_command_controller/ForwardCommandController")
    with pytest.raises(ControllerError, match="contain themselves"):
        read_parameters(kind.parameters_type, endless, "x", Reading())


@each_row("number", [math.nan, math.inf, -math.inf, 10**400, "1", True, None])
def test_a_parameter_that_is_no_number_is_refused_by_name(number):
    with pytest.raises(ControllerError, match=r"x: p must be a (finite )?number, not"):
        read_parameters(Gains, {"p": number}, "x", Reading())


def test_only_limits_may_be_infinite():
    gains = read_parameters(Gains, {"u_clamp_max": math.inf, "i_clamp_min": -math.inf}, "x", Reading())
    assert gains == Gains()
    with pytest.raises(ControllerError, match="u_clamp_max must be a finite number, not nan"):
        read_parameters(Gains, {"u_clamp_max": math.nan}, "x", Reading())


@pytest.mark.parametrize("prefix", ["", "left_"])
def test_the_usual_controllers_are_all_understood(prefix):
    file = usual_controllers(prefix)
    assert not file.notes
    for name, type_name in file.types.items():
        reading = Reading()
        kind = configuration.find(name, type_name)
        controller = kind(name, read_parameters(kind.parameters_type, file.parameters_of(name), name, reading), 500.0)
        controller.on_configure()
        assert not reading.unknown
        assert all(one.startswith(prefix) for one in controller.command_interfaces)


GOALS = """
publisher_joint_trajectory_controller:
  ros__parameters:
    controller_name: "joint_trajectory_controller"
    wait_sec_between_publish: 6
    goal_names: ["pos1", "pos2"]
    pos1:
      positions: [0.785, -1.57]
      velocities: [0.0, 0.0]
    pos2: [0, 1]
    pos3: [1, 1]
    joints: [shoulder_pan_joint, elbow_joint]
    check_starting_point: {check}
    starting_point_limits:
      shoulder_pan_joint: [-0.1, 0.1]
publisher_forward_velocity_controller:
  ros__parameters:
    publish_topic: "/forward_velocity_controller/commands"
    goal_names: [vel]
    vel: [0.0, 0.5]
"""


def test_a_goal_file(tmp_path):
    path = write(tmp_path, GOALS.format(check="true"))
    goals = read_goals(path, "publisher_joint_trajectory_controller")
    assert (goals.controller, goals.commands, goals.wait_s) == ("joint_trajectory_controller", False, 6.0)
    assert [goal.name for goal in goals.goals] == ["pos1", "pos2"]
    assert goals.goals[0].point.velocities == (0.0, 0.0)
    assert goals.goals[1].point.positions == (0.0, 1.0)
    assert len(goals.notes) == 1
    assert "pos3" in goals.notes[0]
    goals.check_start({"shoulder_pan_joint": 0.05, "elbow_joint": -6.0})
    with pytest.raises(ControllerError, match=r"shoulder_pan_joint is at 0\.200 rad, not between -0\.1 and 0\.1"):
        goals.check_start({"shoulder_pan_joint": 0.2, "elbow_joint": 0.0})
    speeds = read_goals(path, "publisher_forward_velocity_controller")
    assert (speeds.controller, speeds.commands) == ("forward_velocity_controller", True)
    with pytest.raises(ControllerError, match="name one of its sections"):
        read_goals(path)
    read_goals(write(tmp_path, GOALS.format(check="false")), goals.node).check_start({"shoulder_pan_joint": 3.0})


def test_the_example_is_read():
    goals = read_goals(Path(__file__).parents[2] / "examples" / "goals.yaml")
    assert not goals.notes
    assert [goal.name for goal in goals.goals] == ["up", "turn", "bend", "back"]
    assert goals.joints == JOINT_NAMES
    goals.check_start(dict(zip(JOINT_NAMES, (0, -1.57, 0, -1.57, 0, 0), strict=True)))


@each_row(
    ("old", "new", "words"),
    [
        ("[0.785, -1.57]", "[0.785]", "pos1.positions has 1 numbers for 2 joints"),
        ("[0.785, -1.57]", "[0.785, high]", "the goal pos1: positions.1. must be a number, not text"),
        ("positions:", "places:", "the goal pos1: unknown 'places'; allowed are positions"),
        ('["pos1", "pos2"]', '["pos1", "home"]', "the goal home has none of positions"),
        ('["pos1", "pos2"]', "[]", "goal_names must be a list of length >= 1"),
        ("[-0.1, 0.1]", "[0.1]", "starting_point_limits.shoulder_pan_joint must be a list of length 2, not 1"),
        ("publish: 6", "publish: soon", "wait_sec_between_publish must be a number"),
        ('controller_name: "joint_trajectory_controller"', "speed: 1", "neither a controller_name"),
    ],
)
def test_goals_that_make_no_sense(tmp_path, old, new, words):
    text = GOALS.format(check="true")
    assert old in text
    with pytest.raises(ControllerError, match=words):
        read_goals(write(tmp_path, text.replace(old, new)), "publisher_joint_trajectory_controller")


def test_the_shell_lists_what_there_is(tmp_path):
    run = CliRunner().invoke
    assert "ScaledJointTrajectoryController" in run(app, ["controllers", "types"]).output
    usual = Path(configuration.__file__).with_name("ur_controllers.yaml")
    (tmp_path / "usual.yaml").write_text(usual.read_text().replace("$(var tf_prefix)", ""))
    listed = run(app, ["controllers", "list", "--controllers", str(tmp_path / "usual.yaml")])
    assert listed.exit_code == 0
    assert "forward_position_controller" in listed.output
    bad = write(
        tmp_path, CONTROLLERS.format(key="ros__parameters").replace("allow_partial_joints_goal: false", "joints: 3")
    )
    broken = run(app, ["controllers", "list", "--controllers", str(bad)])
    assert broken.exit_code == 1
    assert "joints must be a list" in broken.output
    assert "hurry is not a controller" in broken.output


@each_row("line", ["--positions 1,2", "--positions a,b,c,d,e,f", "--positions 1,2,3,4,5,6 --time 0"])
def test_goals_that_the_shell_does_not_take(line):
    assert CliRunner().invoke(app, ["goal", *line.split()]).exit_code == 2
