"""Packages with the launch files of the official driver: what they contain, and which commands they start.

`ros2 launch` is not on PyPI: stand-ins for its actions record what the files declare and start. How the files were
tried with the real one is in docs/reference/ros2_tests.md.
"""

import importlib.util
import itertools
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree

import pytest
import yaml
from typer.testing import CliRunner

from client.cli import app
from client.controllers.configuration import read_controllers
from client.ros2.message_packages import MessagePackages
from client.ros2.overlay import write_overlay
from tests.rows import each_row
from urproto.controlapi import RemoteControl
from urproto.robots import MODELS, Calibration, load_model
from urproto.robots.description import urdf

# Source: DeclareLaunchArgument in ur_control.launch.py of the official driver, July 2026
ALWAYS = (
    "ur_type", "robot_ip", "safety_limits", "safety_pos_margin", "safety_k_position", "controllers_file", "tf_prefix",
    "headless_mode", "controller_spawner_timeout", "initial_joint_controller", "activate_joint_controller",
    "launch_rviz", "launch_dashboard_client", "use_tool_communication", "tool_parity", "tool_baud_rate",
    "tool_stop_bits", "tool_rx_idle_chars", "tool_tx_idle_chars", "tool_device_name", "tool_tcp_port", "tool_voltage",
    "reverse_ip", "script_command_port", "reverse_port", "script_sender_port", "trajectory_port",
)  # fmt: skip
HUMBLE = (
    "runtime_config_package", "description_package", "description_file", "kinematics_params_file", "use_fake_hardware",
    "fake_sensor_commands", "verify_robot_model",
)  # fmt: skip
LYRICAL = (
    "description_launchfile", "use_mock_hardware", "mock_sensor_commands", "rviz_config_file",
    "update_rate_config_file",
)  # fmt: skip


class Recorded:
    """Stands in for an action or a substitution."""

    def __init__(self, *values, **options):
        self.values, self.options = values, options

    def perform(self, context):
        return context.launch_configurations[self.values[0]]

    def evaluate(self, context):
        return self.values[0]

    def items(self):
        return self.options.items()


@pytest.fixture(scope="module")
def overlay(tmp_path_factory):
    folder = tmp_path_factory.mktemp("overlay")
    before = os.environ.pop("AMENT_PREFIX_PATH", None)  # of a workspace that may have ur_description
    write_overlay(MessagePackages(), folder)
    if before is not None:
        os.environ["AMENT_PREFIX_PATH"] = before
    return folder


@pytest.fixture
def load(overlay, monkeypatch):
    """Load a launch file of a package."""
    kinds: dict[str, type] = {}
    for name in (
        "launch",
        "launch.actions",
        "launch.launch_description_sources",
        "launch.substitutions",
        "launch_ros",
        "launch_ros.actions",
        "launch_ros.parameter_descriptions",
        "launch_ros.substitutions",
    ):
        module = ModuleType(name)
        module.__getattr__ = lambda kind: kinds.setdefault(kind, type(kind, (Recorded,), {}))  # type: ignore[method-assign]
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(overlay))

    def load(package, file):
        path = overlay / "share" / package / "launch" / f"{file}.launch.py"
        spec = importlib.util.spec_from_file_location(f"{file}_launch", path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load


@pytest.fixture
def start(load):
    """Start ur_control.launch.py with arguments; returns its actions by kind: command lines, or texts."""

    def start(**given):
        module = load("ur_robot_driver", "ur_control")
        declared = {**module.ARGUMENTS, **module.WITHOUT_EFFECT}
        configurations = {name: default for name, (default, _) in declared.items()}
        context = SimpleNamespace(launch_configurations={**configurations, "robot_ip": "10.0.0.1", "ur_type": "ur5e"})
        context.launch_configurations |= given
        actions = module.start(context)
        commands = {one.options["name"]: one.options["cmd"][1:] for one in actions if "cmd" in one.options}
        notes = [one.options["msg"] for one in actions if "msg" in one.options]
        included = [one for one in actions if type(one).__name__ == "IncludeLaunchDescription"]
        return SimpleNamespace(commands=commands, notes=notes, included=included)

    return start


@pytest.mark.parametrize("names", [ALWAYS, HUMBLE, LYRICAL], ids=["always", "humble", "lyrical"])
def test_the_official_arguments_are_declared(load, names):
    module = load("ur_robot_driver", "ur_control")
    assert set(names) <= {*module.ARGUMENTS, *module.WITHOUT_EFFECT}
    declared = {one.values[0]: one.options for one in module.generate_launch_description().values[0][:-1]}
    assert set(declared) == {*module.ARGUMENTS, *module.WITHOUT_EFFECT}
    assert [name for name, options in declared.items() if options["default_value"] is None] == ["ur_type", "robot_ip"]
    assert set(declared["ur_type"]["choices"]) == set(MODELS)


def options_of(command):
    """Pairs of an option and its value, and options without one."""
    words = itertools.pairwise([*command, "--"])
    return {(word, following) if not following.startswith("--") else (word,) for word, following in words}


@each_row(
    ("given", "expected"),
    [
        ({}, {("--robot-ip", "10.0.0.1"), ("--no-headless",), ("--ur-type", "ur5e"), ("--tf-prefix", "")}),
        ({"headless_mode": "true"}, {("--headless",)}),
        ({"verify_robot_model": "false"}, {("--no-headless",)}),
        (
            {"initial_joint_controller": "forward_position_controller"},
            {("--controller", "forward_position_controller")},
        ),
        ({"activate_joint_controller": "false"}, {("--controller", "")}),
        ({"launch_dashboard_client": "false"}, {("--no-dashboard-client",)}),
        ({"use_sim_time": "true"}, {("--use-sim-time",)}),
        ({"tf_prefix": "left_"}, {("--tf-prefix", "left_")}),
        ({"ros_namespace": "/left"}, {("--namespace", "left")}),
        ({"reverse_ip": "10.0.0.2"}, {("--driver", "own_address=10.0.0.2")}),
        ({"reverse_port": "50011"}, {("--driver", "reverse_port=50011")}),
        ({"script_sender_port": "50012"}, {("--driver", "sender_port=50012")}),
        ({"trajectory_port": "50013"}, {("--driver", "trajectory_port=50013")}),
        ({"script_command_port": "50014"}, {("--driver", "command_port=50014")}),
        ({"controllers_file": "/a/mine.yaml"}, {("--controllers", "/a/mine.yaml")}),
        (
            {"use_tool_communication": "true", "tool_parity": "2", "tool_voltage": "24"},
            {("--driver", "tool_communication.parity=2"), ("--driver", "tool_voltage=24")},
        ),
    ],
)
def test_arguments_become_options(start, given, expected):
    started = start(launch_rviz="false", **given)
    assert expected <= options_of(started.commands["ur_ros2_driver"])
    assert started.notes == []
    refuses = ("--ur-type", "ur5e") in options_of(started.commands["ur_ros2_driver"])
    assert refuses is (given.get("verify_robot_model") != "false")


def test_every_command_is_one_that_the_command_line_takes(start):
    """A word that typer does not know ends with 2 and says so, before anything is started."""
    started = start(use_tool_communication="true", reverse_ip="10.0.0.2", headless_mode="true", launch_rviz="false")
    for command in started.commands.values():
        refused = CliRunner().invoke(app, [*command, "--no-such-option"])
        assert "--no-such-option" in refused.output
    settings = [word for option, word in itertools.pairwise(started.commands["ur_ros2_driver"]) if option == "--driver"]
    wrong = CliRunner().invoke(app, ["ros2", *(f"--driver={word}" for word in settings), "--driver=colour=red"])
    assert "'colour=red' is not a setting of the driver" in " ".join(wrong.output.split())


@pytest.mark.parametrize("robot_ip", ["0.0.0.0", "127.0.0.5"])
def test_mock_hardware_is_an_emulator(start, robot_ip):
    started = start(use_mock_hardware="true", robot_ip=robot_ip, ur_type="ur3", launch_rviz="false")
    address = "127.0.0.1" if robot_ip == "0.0.0.0" else robot_ip
    emulator = options_of(started.commands["ur_emulator"])
    assert {("--model", "ur3"), ("--host", address), ("--running",)} <= emulator
    assert ("--robot-ip", address) in options_of(started.commands["ur_ros2_driver"])


def test_what_has_no_effect_is_named(start):
    (note,) = start(safety_pos_margin="0.2", launch_rviz="false").notes
    assert note.startswith("ur_control: safety_pos_margin has no effect: give a description_launchfile")
    assert start().notes == ["ur_control: RViz is not installed here; launch_rviz:=false omits this line"]
    with pytest.raises(RuntimeError, match="headless_mode must be true or false, not 'yes'"):
        start(headless_mode="yes")


def test_a_description_of_ones_own_replaces_that_of_the_driver(start):
    started = start(description_launchfile="/mine.launch.py", launch_rviz="false")
    assert ("--no-robot-state-publisher",) in options_of(started.commands["ur_ros2_driver"])
    (included,) = started.included
    assert dict(included.options["launch_arguments"]) == {"robot_ip": "10.0.0.1", "ur_type": "ur5e"}


def test_every_other_launch_file_is_read(load, overlay):
    files = sorted(overlay.glob("share/*/launch/*.launch.py"))
    assert {f"{name}.launch.py" for name in MODELS} <= {file.name for file in files}
    for file in files:
        described = load(file.parts[-3], file.name.removesuffix(".launch.py")).generate_launch_description()
        assert described.values[0]


def test_the_packages_are_found_and_complete(overlay):
    for package in ("ur_robot_driver", "ur_description", "ur_moveit_config", "ur_calibration", "ur_client_library"):
        assert (overlay / "share/ament_index/resource_index/packages" / package).exists()
        ElementTree.parse(overlay / "share" / package / "package.xml")
        assert os.access(overlay / "lib" / package / "ur_client", os.X_OK)
    assert read_controllers(overlay / "share/ur_robot_driver/config/ur_controllers.yaml").notes == ()
    found = subprocess.run(
        ["bash", "-c", f". {overlay}/setup.bash && echo $AMENT_PREFIX_PATH"],
        env={"AMENT_PREFIX_PATH": "/opt/ros/x"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout == f"{overlay}:/opt/ros/x\n"


def test_an_installed_description_is_left_alone(overlay, tmp_path, monkeypatch):
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(overlay))
    write_overlay(MessagePackages(), tmp_path)
    assert not list(tmp_path.glob("share/ur_description/*"))
    assert (tmp_path / "share/ur_robot_driver/launch/ur_control.launch.py").exists()


def filled(text, names):
    """What xacro makes of the expressions in a text."""
    return re.sub(r"\$\{(.*?)\}", lambda found: str(eval(found[1], {}, names)), text)


@each_row("name", MODELS)
def test_the_macro_of_an_arm_is_its_urdf(overlay, name):
    """With the files of the package; `calibrated` ones move the joints' frames."""
    share = overlay / "share/ur_description"
    config = {path.stem: yaml.safe_load(path.read_text()) for path in (share / "config" / name).glob("*.yaml")}
    names = {
        "tf_prefix": "left_",
        "kinematics": config["default_kinematics"]["kinematics"],
        "limits": config["joint_limits"]["joint_limits"],
        "safety_limits": False,
        "safety_pos_margin": 0.15,
        "safety_k_position": 20,
    }
    model = load_model(name)
    assert config["physical_parameters"]["ur_type"] == name
    assert Calibration.from_mapping(config["default_kinematics"], "file").hash == Calibration.of(model.dh).hash
    (macro,) = ElementTree.fromstring(filled((share / f"urdf/inc/{name}.xacro").read_text(), names))
    assert macro.get("name") == f"ur_arm_{name}"
    for made, expected in zip(macro, ElementTree.fromstring(urdf(model, prefix="left_")), strict=True):
        parts = [part for part in made.iter() if "xacro" not in part.tag and part.tag != "safety_controller"]
        for part, wanted in zip(parts, expected.iter(), strict=True):
            assert part.tag == wanted.tag
            assert dict(part.items()).keys() == dict(wanted.items()).keys()
            for value, other in zip(part.attrib.values(), wanted.attrib.values(), strict=True):
                numbers = re.fullmatch(r"[-+.e\d ]+", other)
                assert (
                    [float(one) for one in value.split()] == pytest.approx([float(one) for one in other.split()])
                    if numbers
                    else value == other
                )


def test_start_ursim_starts_an_emulator(overlay):
    """With the options of the official script. The line that it prints says how to end it."""
    script, address = overlay / "lib/ur_client_library/start_ursim.sh", "127.0.0.77"
    words = ["-m", "ur3", "-v", "3.15.8", "-i", address, "-n", "ursim", "-d"]
    started = subprocess.run([str(script), *words], capture_output=True, text=True, timeout=120)
    assert started.returncode == 0, started.stderr
    process = int(started.stdout.split()[-1])
    try:
        robot = RemoteControl(address)
        assert robot.describe()["model"] == "ur3"
        robot.close()
    finally:
        os.kill(process, signal.SIGINT)
        while Path(f"/proc/{process}").exists() and "Z" not in Path(f"/proc/{process}/stat").read_text().split()[2]:
            time.sleep(0.05)
    wrong = subprocess.run([str(script), "-x"], capture_output=True, text=True, timeout=60)
    assert (wrong.returncode, "Usage" in wrong.stderr) == (2, True)
