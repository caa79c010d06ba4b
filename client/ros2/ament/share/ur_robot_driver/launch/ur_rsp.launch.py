"""robot_state_publisher with the description of ur_robot_driver/urdf/ur.urdf.xacro, or one of your own.

The driver of this package publishes the description itself, unless it is started with a description_launchfile.
"""

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import Command, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

# name: (default, what it is); None: it has to be given. Source of the names: ur_rsp.launch.py of the official driver.
ARGUMENTS = {
    "ur_type": (None, "The arm."),
    "robot_ip": (None, "Address of the robot or emulator."),
    "tf_prefix": ("", "Prefix of the names of joints and frames."),
    "safety_limits": ("true", "Whether joints have safety_controller tags."),
    "safety_pos_margin": ("0.15", "Their margin to the joints' limits [rad]."),
    "safety_k_position": ("20", "Their k_position."),
}
FILES = {
    "kinematics_params": ("kinematics_params_file", "default_kinematics.yaml", "Calibration of the arm."),
    "joint_limit_params": ("joint_limit_params_file", "joint_limits.yaml", "Limits of the joints."),
    "physical_params": ("physical_params_file", "physical_parameters.yaml", "Masses and shapes: the name of the arm."),
    "visual_params": ("visual_params_file", "visual_parameters.yaml", "Unused."),
}


def generate_launch_description():
    default = f"{get_package_share_directory('ur_robot_driver')}/urdf/ur.urdf.xacro"
    declared = [DeclareLaunchArgument("description_file", default_value=default, description="The xacro file.")]
    command = ["xacro ", LaunchConfiguration("description_file"), " name:=", LaunchConfiguration("ur_type")]
    for name, (value, text) in ARGUMENTS.items():
        declared.append(DeclareLaunchArgument(name, default_value=value, description=text))
        command += [f" {name}:=", LaunchConfiguration(name)]
    for name, (argument, file, text) in FILES.items():
        path = PathJoinSubstitution(
            [FindPackageShare("ur_description"), "config", LaunchConfiguration("ur_type"), file]
        )
        declared.append(DeclareLaunchArgument(argument, default_value=path, description=text))
        command += [f" {name}:=", LaunchConfiguration(argument)]
    description = ParameterValue(Command(command), value_type=str)
    publisher = Node(
        package="robot_state_publisher",
        executable="robot_state_publisher",
        output="both",
        parameters=[{"robot_description": description}],
    )
    return LaunchDescription([*declared, publisher])
