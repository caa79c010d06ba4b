"""The ROS 2 driver of ur-emulator's client, with the arguments of the official launch file, from Humble to Lyrical.

One process has the controllers and all nodes of the official driver; its command is `ur-client ros2`.
"""

from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix, get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription, LogInfo, OpaqueFunction
from launch.launch_description_sources import AnyLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile

TYPES = ["ur3", "ur5", "ur10", "ur3e", "ur5e", "ur7e", "ur10e", "ur12e", "ur16e", "ur8long", "ur15", "ur18", "ur20",
         "ur30"]  # fmt: skip
CONTROLLERS = ["", "scaled_joint_trajectory_controller", "joint_trajectory_controller", "forward_velocity_controller",
               "forward_position_controller", "forward_effort_controller", "freedrive_mode_controller",
               "passthrough_trajectory_controller", "motion_primitive_forward_controller"]  # fmt: skip
EMULATOR = "127.0.0.1"  # of use_mock_hardware, unless robot_ip is another address of this machine
FROM_ROBOT = "the driver reads the model and the calibration from the robot"
OWN_PUBLISHER = "give a description_launchfile to publish a description of your own"
MODE = "the emulator that use_mock_hardware starts has its own sensors"
STARTED = "controllers are started by the driver itself"

# name: (default, what it is); None: it has to be given
ARGUMENTS = {
    "ur_type": (None, "The arm: a robot of another type is refused, unless verify_robot_model is false."),
    "robot_ip": (None, "Address of the robot or emulator."),
    "controllers_file": ("ur_controllers.yaml", "The controllers: a path, or a file of runtime_config_package."),
    "runtime_config_package": ("ur_robot_driver", "Package whose folder config has the controllers file."),
    "description_launchfile": ("", "Launch file that publishes the robot's description instead of the driver."),
    "use_sim_time": ("false", "Stamp messages with the robot's time, and publish it as /clock."),
    "tf_prefix": ("", "Prefix of the names of joints, frames and interfaces."),
    "use_mock_hardware": ("false", "Start an emulator of ur_type, with its brakes released, and use it."),
    "use_fake_hardware": ("false", "The same, as in Humble."),
    "headless_mode": ("false", "Send the control program to the robot instead of waiting until it is played there."),
    "initial_joint_controller": ("", "Controller to start with; by default the file's trajectory controller."),
    "activate_joint_controller": ("true", "Whether to activate it."),
    "launch_rviz": ("true", "Start RViz, if it is installed."),
    "rviz_config_file": ("", "Its configuration; by default view_robot.rviz of ur_description."),
    "launch_dashboard_client": ("true", "Whether there is a node dashboard_client."),
    "verify_robot_model": ("true", "Whether to refuse a robot that is not a ur_type."),
    "use_tool_communication": ("false", "Provide the serial line at the tool (e-Series) as tool_device_name."),
    "tool_device_name": ("/tmp/ttyUR", "The serial device to create."),
    "tool_voltage": ("0", "Voltage of the tool connector [V]."),
    "tool_parity": ("0", "Parity of the serial line: 0 none, 1 odd, 2 even."),
    "tool_baud_rate": ("115200", "Its baud rate."),
    "tool_stop_bits": ("1", "Its stop bits."),
    "tool_rx_idle_chars": ("1.5", "Idle characters of its receiver."),
    "tool_tx_idle_chars": ("3.5", "Idle characters of its sender."),
    "reverse_ip": ("0.0.0.0", "Address of this machine as the robot sees it; 0.0.0.0 determines it."),
    "reverse_port": ("50001", "Port for setpoints."),
    "script_sender_port": ("50002", "Port from which External Control fetches its program."),
    "trajectory_port": ("50003", "Port for trajectories."),
    "script_command_port": ("50004", "Port for script commands."),
}
# arguments of the official file without an effect here: (default, why)
WITHOUT_EFFECT = {
    "safety_limits": ("true", OWN_PUBLISHER),
    "safety_pos_margin": ("0.15", OWN_PUBLISHER),
    "safety_k_position": ("20", OWN_PUBLISHER),
    "description_package": ("ur_description", OWN_PUBLISHER),
    "description_file": ("ur.urdf.xacro", OWN_PUBLISHER),
    "kinematics_params_file": ("", FROM_ROBOT),
    "mock_sensor_commands": ("false", MODE),
    "fake_sensor_commands": ("false", MODE),
    "controller_spawner_timeout": ("10", STARTED),
    "update_rate_config_file": ("", "controllers are updated with each state of the robot"),
    "tool_tcp_port": ("54321", "a robot offers the tool's serial line on this port only"),
}
SILENT = ("controller_spawner_timeout", "kinematics_params_file", "update_rate_config_file")  # they lose nothing
kept_files = []  # files with substituted values are deleted with their object


def is_true(name, value):
    if value.lower() in ("true", "1"):
        return True
    if value.lower() in ("false", "0"):
        return False
    raise RuntimeError(f"{name} must be true or false, not {value!r}")


def tool(name):
    return str(Path(get_package_prefix("ur_robot_driver"), "lib", "ur_robot_driver", name))


def share(package, *parts):
    return str(Path(get_package_share_directory(package), *parts))


def is_installed(package):
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return False
    return True


def substituted(path, context):
    """The path of a copy of a parameter file in which $(var name) is replaced."""
    context.launch_configurations.setdefault("update_rate", "500")
    file = ParameterFile(path, allow_substs=True)
    kept_files.append(file)
    return str(file.evaluate(context))


def start(context):
    given = {name: LaunchConfiguration(name).perform(context) for name in (*ARGUMENTS, *WITHOUT_EFFECT)}
    actions = [
        LogInfo(msg=f"ur_control: {name} has no effect: {why}")
        for name, (default, why) in WITHOUT_EFFECT.items()
        if given[name] != default and name not in SILENT
    ]

    def flag(name):
        return is_true(name, given[name])

    robot_ip = given["robot_ip"]
    if flag("use_mock_hardware") or flag("use_fake_hardware"):
        robot_ip = robot_ip if robot_ip.startswith("127.") else EMULATOR
        emulator = [tool("ur_emulator"), "--model", given["ur_type"], "--host", robot_ip, "--running", "--no-pendant"]
        actions.append(ExecuteProcess(cmd=emulator, name="ur_emulator", output="screen"))
    controllers = Path(given["controllers_file"])
    if not controllers.is_absolute():
        controllers = Path(share(given["runtime_config_package"], "config"), controllers)
    command = [tool("ur_client"), "ros2", "--robot-ip", robot_ip, "--tf-prefix", given["tf_prefix"]]
    command += ["--controllers", substituted(str(controllers), context)]
    command += ["--headless" if flag("headless_mode") else "--no-headless"]
    if flag("use_sim_time"):
        command += ["--use-sim-time"]
    if flag("verify_robot_model"):
        command += ["--ur-type", given["ur_type"]]
    if not flag("activate_joint_controller"):
        command += ["--controller", ""]
    elif given["initial_joint_controller"]:
        command += ["--controller", given["initial_joint_controller"]]
    if not flag("launch_dashboard_client"):
        command += ["--no-dashboard-client"]
    if namespace := context.launch_configurations.get("ros_namespace", "").strip("/"):
        command += ["--namespace", namespace]
    settings = {
        "reverse_port": given["reverse_port"],
        "sender_port": given["script_sender_port"],
        "trajectory_port": given["trajectory_port"],
        "command_port": given["script_command_port"],
    }
    if given["reverse_ip"] != "0.0.0.0":
        settings["own_address"] = given["reverse_ip"]
    if flag("use_tool_communication"):
        settings["tool_voltage"] = given["tool_voltage"]
        for name in ("baud_rate", "parity", "stop_bits", "rx_idle_chars", "tx_idle_chars"):
            settings[f"tool_communication.{name}"] = given[f"tool_{name}"]
        line = [tool("ur_client"), "tool-comm", "--robot-ip", robot_ip, "--device", given["tool_device_name"]]
        actions.append(ExecuteProcess(cmd=line, name="ur_tool_comm", output="screen"))
    for name, value in settings.items():
        command += ["--driver", f"{name}={value}"]
    if given["description_launchfile"]:
        command += ["--no-robot-state-publisher"]
        source = AnyLaunchDescriptionSource(given["description_launchfile"])
        arguments = {"robot_ip": robot_ip, "ur_type": given["ur_type"]}
        actions.append(IncludeLaunchDescription(source, launch_arguments=arguments.items()))
    actions.append(ExecuteProcess(cmd=command, name="ur_ros2_driver", output="screen", emulate_tty=True))
    if flag("launch_rviz"):
        actions.append(rviz(given["rviz_config_file"]))
    return actions


def rviz(config):
    if not is_installed("rviz2"):
        return LogInfo(msg="ur_control: RViz is not installed here; launch_rviz:=false omits this line")
    config = config or share("ur_description", "rviz", "view_robot.rviz")
    return Node(package="rviz2", executable="rviz2", name="rviz2", output="log", arguments=["-d", config])


def generate_launch_description():
    choices = {"ur_type": TYPES, "initial_joint_controller": CONTROLLERS}
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text, choices=choices.get(name))
        for name, (default, text) in ARGUMENTS.items()
    ]
    declared += [
        DeclareLaunchArgument(name, default_value=default, description=f"No effect: {why}.")
        for name, (default, why) in WITHOUT_EFFECT.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])
