"""The node dashboard_client alone, with the arguments of the official launch file.

`ur_control.launch.py` has this node in the process of the driver.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackagePrefix


def generate_launch_description():
    client = PathJoinSubstitution([FindPackagePrefix("ur_robot_driver"), "lib", "ur_robot_driver", "ur_client"])
    node = [client, "ros2", "--only", "dashboard_client", "--robot-ip", LaunchConfiguration("robot_ip")]
    parameters = [
        "--",
        "-p",
        ["receive_timeout:=", LaunchConfiguration("dashboard_receive_timeout")],
        "-p",
        ["autoconnect:=", LaunchConfiguration("autoconnect")],
    ]
    return LaunchDescription(
        [
            DeclareLaunchArgument("robot_ip", description="Address of the robot or emulator."),
            DeclareLaunchArgument(
                "dashboard_receive_timeout", default_value="20.0", description="Time limit for an answer [s]."
            ),
            DeclareLaunchArgument(
                "autoconnect", default_value="true", description="If false, ~/connect connects to the robot."
            ),
            ExecuteProcess(cmd=[*node, *parameters], name="dashboard_client", output="screen"),
        ]
    )
