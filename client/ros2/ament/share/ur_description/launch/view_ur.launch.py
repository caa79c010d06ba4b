"""Look at an arm in RViz, with sliders for its joints. Needs joint_state_publisher_gui, robot_state_publisher, RViz."""

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import Command, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description():
    share = get_package_share_directory("ur_description")
    ur_type, prefix = LaunchConfiguration("ur_type"), LaunchConfiguration("tf_prefix")
    command = [f"xacro {share}/urdf/ur.urdf.xacro name:=ur ur_type:=", ur_type, " tf_prefix:=", prefix]
    description = {"robot_description": ParameterValue(Command(command), value_type=str)}
    return LaunchDescription(
        [
            DeclareLaunchArgument("ur_type", description="The arm, for example ur3."),
            DeclareLaunchArgument("tf_prefix", default_value="", description="Prefix of joints and frames."),
            Node(package="joint_state_publisher_gui", executable="joint_state_publisher_gui"),
            Node(package="robot_state_publisher", executable="robot_state_publisher", parameters=[description]),
            Node(package="rviz2", executable="rviz2", arguments=["-d", f"{share}/rviz/view_robot.rviz"]),
        ]
    )
