"""Ament packages with the launch files of the official driver, which start this one.

`write_overlay` writes an install folder with ``ur_robot_driver``, ``ur_moveit_config``, ``ur_calibration``,
``ur_client_library`` (its script that starts a simulator) and, unless one is installed, ``ur_description``. In a shell
that has sourced its ``setup.bash``, ``ros2 launch ur_robot_driver ur_control.launch.py`` and launch files that include
it start ``ur-client ros2``.
"""

import importlib.metadata
import os
import shlex
from importlib import resources
from pathlib import Path
from typing import Any, Final
from xml.etree.ElementTree import Element, SubElement, fromstring, indent, register_namespace, tostring

import yaml

from client.ros2.message_packages import MessagePackages, default_cache
from urproto.compat import module_command
from urproto.durable import write_file
from urproto.joints import JOINT_NAMES
from urproto.robots import MODELS, Calibration, RobotModel, load_model
from urproto.robots.calibration import LINKS
from urproto.robots.description import urdf

PACKAGES: Final = ("ur_robot_driver", "ur_description", "ur_moveit_config", "ur_calibration", "ur_client_library")
_FILES: Final = Path(__file__).with_name("ament")
_COMMANDS: Final = {"ur_client": "client", "ur_emulator": "emulator"}  # executables of packages: modules
_LIMITS: Final = {"lower": "min_position", "upper": "max_position", "effort": "max_effort", "velocity": "max_velocity"}
_XACRO: Final = "http://wiki.ros.org/xacro"
_PREFIX: Final = "${tf_prefix}"
_PACKAGE_XML: Final = """<?xml version="1.0"?>
<package format="3">
  <name>{name}</name>
  <version>{version}</version>
  <description>Launch files that start the driver of ur-emulator's client.</description>
  <maintainer email="nobody@example.org">ur-emulator</maintainer>
  <license>Apache-2.0</license>
</package>
"""
_ONE_TYPE: Final = '''"""ur_control.launch.py for a {name}; it takes all of its arguments."""

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration


def generate_launch_description():
    source = PythonLaunchDescriptionSource(
        get_package_share_directory("ur_robot_driver") + "/launch/ur_control.launch.py"
    )
    arguments = {{"ur_type": "{name}", "robot_ip": LaunchConfiguration("robot_ip")}}
    return LaunchDescription(
        [
            DeclareLaunchArgument("robot_ip", description="Address of the robot or emulator."),
            IncludeLaunchDescription(source, launch_arguments=arguments.items()),
        ]
    )
'''


def write_overlay(messages: MessagePackages, folder: Path | None = None) -> Path:
    """Write the packages, and return the file to source in a shell. Raises OSError.

    messages: the message packages, which that file makes available too. folder: by default in the user's cache.
    """
    prefix = folder or default_cache() / "overlay"
    others = [Path(place) for place in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if place]
    described = any((place / _marker("ur_description")).exists() for place in others if place != prefix)
    for path, text in _files().items():
        if described and "ur_description" in Path(path).parts:
            continue
        place = prefix / path
        place.parent.mkdir(parents=True, exist_ok=True)
        write_file(place, text)
        if text.startswith("#!"):
            place.chmod(0o755)
    setup = prefix / "setup.bash"
    lines = ["# Source this, after the workspace if there is one: ros2 launch then finds the driver."]
    if messages.setup_file is not None:
        lines.append(f". {shlex.quote(str(messages.setup_file))}")
    lines.append(f'export AMENT_PREFIX_PATH="{prefix}${{AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}}"')
    write_file(setup, "\n".join(lines) + "\n")
    return setup


def _marker(package: str) -> str:
    return f"share/ament_index/resource_index/packages/{package}"


def _files() -> dict[str, str]:
    """The text of each file of the packages, by its path in the install folder."""
    files = {
        path.relative_to(_FILES).as_posix(): path.read_text("utf-8") for path in _FILES.rglob("*") if path.is_file()
    }
    version = importlib.metadata.version("ur-emulator")
    for package in PACKAGES:
        files[_marker(package)] = ""
        files[f"share/{package}/package.xml"] = _PACKAGE_XML.format(name=package, version=version)
        for command, module in _COMMANDS.items():
            files[f"lib/{package}/{command}"] = f'#!/bin/sh\nexec {shlex.join(module_command(module))} "$@"\n'
    driver = "share/ur_robot_driver"
    controllers = resources.files("client.controllers") / "ur_controllers.yaml"
    files[f"{driver}/config/ur_controllers.yaml"] = controllers.read_text("utf-8")
    files |= {f"{driver}/launch/{name}.launch.py": _ONE_TYPE.format(name=name) for name in MODELS}
    for name in MODELS:
        files |= {f"share/ur_description/{path}": text for path, text in _description(load_model(name)).items()}
    return files


def _description(model: RobotModel) -> dict[str, str]:
    """The files of an arm, in the places and formats of ur_description; its links and joints as a xacro macro."""
    limits = {name: _limits(model, joint) for joint, name in enumerate(JOINT_NAMES)}
    contents: dict[str, Any] = {
        "default_kinematics": Calibration.of(model.dh).to_mapping(),
        "joint_limits": {"joint_limits": limits},
        "physical_parameters": {"ur_type": model.name},
        "visual_parameters": {"ur_type": model.name},
    }
    files = {
        f"config/{model.name}/{name}.yaml": yaml.safe_dump(content, sort_keys=False)
        for name, content in contents.items()
    }
    return {**files, f"urdf/inc/{model.name}.xacro": _macro(model)}


def _limits(model: RobotModel, joint: int) -> dict[str, float | bool]:
    endless = joint == 5 and model.wrist3_unlimited
    return {
        "has_acceleration_limits": False,
        "has_effort_limits": True,
        "has_position_limits": not endless,
        "has_velocity_limits": True,
        "max_effort": model.torque_max[joint],
        "max_position": model.q_max[joint],
        "max_velocity": model.qd_max[joint],
        "min_position": model.q_min[joint],
    }


def _macro(model: RobotModel) -> str:
    """The URDF of an arm as a macro that takes calibration, limits and prefix from its caller."""
    register_namespace("xacro", _XACRO)
    root = Element("robot")
    macro = SubElement(root, f"{{{_XACRO}}}macro", name=f"ur_arm_{model.name}", params="")
    macro.extend(fromstring(urdf(model, prefix=_PREFIX)))
    for link, name in zip(LINKS, JOINT_NAMES, strict=True):
        joint = next(one for one in macro if one.tag == "joint" and one.get("name") == _PREFIX + name)
        for part in joint:
            if part.tag == "origin":
                part.attrib = {"xyz": _of_link(link, "x", "y", "z"), "rpy": _of_link(link, "roll", "pitch", "yaw")}
            elif part.tag == "limit":
                part.attrib = {attribute: f"${{limits['{name}']['{key}']}}" for attribute, key in _LIMITS.items()}
        if joint.get("type") == "revolute":
            condition = SubElement(joint, f"{{{_XACRO}}}if", value="${safety_limits}")
            soft = {
                "soft_lower_limit": f"${{limits['{name}']['min_position'] + safety_pos_margin}}",
                "soft_upper_limit": f"${{limits['{name}']['max_position'] - safety_pos_margin}}",
                "k_position": "${safety_k_position}",
                "k_velocity": "0",
            }
            SubElement(condition, "safety_controller", soft)
        else:
            del joint.find("limit").attrib["lower"], joint.find("limit").attrib["upper"]  # type: ignore[union-attr]
    indent(root)
    return '<?xml version="1.0"?>\n' + tostring(root, encoding="unicode") + "\n"


def _of_link(link: str, *values: str) -> str:
    return " ".join(f"${{kinematics['{link}']['{value}']}}" for value in values)
