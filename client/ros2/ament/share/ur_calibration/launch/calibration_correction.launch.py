"""Save the calibration of a robot in the format of ur_description, with the arguments of the official launch file."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackagePrefix


def generate_launch_description():
    client = PathJoinSubstitution([FindPackagePrefix("ur_calibration"), "lib", "ur_calibration", "ur_client"])
    robot_ip, target = LaunchConfiguration("robot_ip"), LaunchConfiguration("target_filename")
    return LaunchDescription(
        [
            DeclareLaunchArgument("robot_ip", description="Address of the robot or emulator."),
            DeclareLaunchArgument(
                "target_filename", default_value="robot_calibration.yaml", description="The YAML file to write."
            ),
            ExecuteProcess(
                cmd=[client, "calibration", "--robot-ip", robot_ip, "--output", target],
                name="calibration_correction",
                output="screen",
            ),
        ]
    )
