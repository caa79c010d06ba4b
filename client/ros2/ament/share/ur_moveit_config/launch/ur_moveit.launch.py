"""RViz beside the node move_group, which `ur_control.launch.py` starts with the driver (extra ``plan``)."""

from ament_index_python.packages import PackageNotFoundError, get_package_prefix, get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

# name: (default, what it is, why it has no effect). Source of the names: ur_moveit.launch.py of the official driver.
ARGUMENTS = {
    "ur_type": ("", "The arm.", "move_group has the model of the driver's robot"),
    "launch_rviz": ("true", "Start RViz, if it is installed.", ""),
    "launch_servo": ("false", "Start MoveIt Servo; here, it always runs in the driver's process.", ""),
    "use_sim_time": ("false", "Use the topic /clock.", "give it to ur_control.launch.py, which starts move_group"),
    "warehouse_sqlite_path": ("", "Database of scenes.", "there is no warehouse here"),
    "publish_robot_description_semantic": ("true", "Publish the SRDF.", "move_group always publishes it"),
}


def start(context):
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    notes = ["move_group runs in the process of the driver; ur_control.launch.py starts it"]
    notes += [
        f"{name} has no effect: {why}"
        for name, (default, _, why) in ARGUMENTS.items()
        if why and name != "ur_type" and given[name] != default
    ]
    actions = [LogInfo(msg=f"ur_moveit: {note}") for note in notes]
    if given["launch_rviz"].lower() not in ("true", "1"):
        return actions
    try:
        get_package_prefix("rviz2")
    except PackageNotFoundError:
        return [*actions, LogInfo(msg="ur_moveit: RViz is not installed here; launch_rviz:=false omits this line")]
    config = f"{get_package_share_directory('ur_description')}/rviz/view_robot.rviz"
    return [*actions, Node(package="rviz2", executable="rviz2", name="rviz2", output="log", arguments=["-d", config])]


def generate_launch_description():
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text, _) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])
