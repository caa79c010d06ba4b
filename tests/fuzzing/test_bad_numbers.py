"""Unusable numbers in files are refused by name, or all results are finite."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Final, cast

import pytest
import yaml

from client.calibration import read_calibration as read_calibration_of_client
from client.controllers.broadcasters import ForceTorqueSensorBroadcaster
from client.controllers.configuration import read_controllers
from client.controllers.controller import LifecycleState
from client.controllers.goals import JointTrajectory, JointTrajectoryPoint
from client.controllers.manager import ControllerManager
from client.controllers.ur_hardware import URHardware
from client.errors import ClientError
from emulator.config import ConfigError, read_calibration, read_initial_positions, read_safety, read_surroundings
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from tests.budget import subset
from tests.rows import each_row
from urproto.external_control import from_words, to_words
from urproto.joints import JOINT_NAMES
from urproto.modes import RobotMode, RuntimeState, SafetyMode
from urproto.robots import load_model
from urproto.versions import PolyscopeVersion
from urscript.polyscope.document import DocumentError
from urscript.polyscope.installation_file import read_installation

GOLDEN: Final = Path(__file__).parents[1] / "golden"
BAD: Final[tuple[Any, ...]] = (
    math.nan,
    math.inf,
    -math.inf,
    1e308,
    -1e308,
    10**400,
    -1,
    0,
    "one",
    None,
    True,
    [],
    {},
    [0.0] * 100,
)
SIBLINGS: Final = ("upper_arm", "forearm", "wrist_1", "wrist_2")  # read as shoulder and wrist_3 are
MISSING: Final = object()

POSITIONS: Final = dict.fromkeys(JOINT_NAMES, 0.5)
WORLD: Final = {
    "tool": {"box": [0.1, 0.1, 0.1], "pose": [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]},
    "objects": {"ball": {"sphere": 0.1, "pose": [0.5, 0.0, 0.1], "stiffness": 1e4, "damping": 1.0, "friction": 0.2}},
}
SAFETY: Final = {
    "normal": {"tcp_speed": 1.0, "force": 120.0, "joint_min": [-3.0] * 6, "joint_max": [3.0] * 6},
    "planes": [{"normal": [0.0, 0.0, 1.0], "distance": 0.1}],
    "tool_orientation": {"direction": [0.0, 0.0, 1.0], "deviation": 0.3},
    "inputs": {"emergency_stop": [0, 1]},
    "safe_home": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
}
CALIBRATION: Final = yaml.safe_load((GOLDEN / "calibration_ur5e.yaml").read_text())
LISTS: Final = {
    "dh_theta": [0.0] * 6,
    "dh_a": [0.0, -0.425, -0.3922, 0.0, 0.0, 0.0],
    "dh_d": [0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996],
    "dh_alpha": [1.570796327, 0.0, 0.0, 1.570796327, -1.570796327, 0.0],
}
CONTROLLERS: Final = {
    "controller_manager": {
        "ros__parameters": {
            "arm": {"type": "ur_controllers/ScaledJointTrajectoryController"},
            "sensor": {"type": "force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster"},
        }
    },
    "arm": {
        "ros__parameters": {
            "joints": list(JOINT_NAMES),
            "command_interfaces": ["velocity"],
            "state_interfaces": ["position", "velocity"],
            "cmd_timeout": 0.1,
            "constraints": {"goal_time": 0.5, "elbow_joint": {"goal": 0.1, "max_deceleration_on_cancel": 4.0}},
            "gains": {"elbow_joint": {"p": 2.0, "i": 0.1, "d": 0.1, "ff_velocity_scale": 1.0, "u_clamp_min": -1.0}},
            "speed_scaling": {"initial_scaling_factor": 0.5},
        }
    },
    "sensor": {"ros__parameters": {"sensor_name": "tcp_fts_sensor", "offset": {"force": {"x": 0.5}}}},
}


def places(content: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The paths of all values, at any depth."""
    if path:
        yield path
    rows = content[:1] if isinstance(content, list) else []  # the other rows are read like the first
    inner = content.items() if isinstance(content, Mapping) else enumerate(rows)
    for key, value in inner:
        yield from places(value, (*path, key))


def changed(content: Any, path: tuple[Any, ...], value: Any) -> Any:
    """The content with one value replaced."""
    copy = deepcopy(content)
    at = copy
    for key in path[:-1]:
        at = at[key]
    if value is MISSING:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return copy


def not_finite(value: Any, where: str = "", seen: frozenset[int] = frozenset()) -> list[str]:
    """The places of numbers that are not finite, in values read or published."""
    if isinstance(value, float):
        return [] if math.isfinite(value) else [f"{where} = {value}"]
    if id(value) in seen or isinstance(value, str | bytes | int | type):
        return []
    seen = seen | {id(value)}
    if is_dataclass(value):
        return [w for f in fields(value) for w in not_finite(getattr(value, f.name, 0), f"{where}.{f.name}", seen)]
    if isinstance(value, Mapping):
        return [w for key, item in value.items() for w in not_finite(item, f"{where}[{key}]", seen)]
    if isinstance(value, list | tuple | set | frozenset):
        return [w for n, item in enumerate(value) for w in not_finite(item, f"{where}[{n}]", seen)]
    return []


def published(**settings: Any) -> list[str]:
    """Published values of an arm with these settings that are not finite."""
    controller = Controller(ControllerConfig(**({"model": load_model("ur5e"), "running": True} | settings)))
    for _ in range(3):
        controller.tick()
    return not_finite(controller.snapshot, "snapshot")


def _positions(path: Path) -> list[str]:
    return published(initial_q=read_initial_positions(path, load_model("ur5e")))


def _world(path: Path) -> list[str]:
    return published(world=read_surroundings(path))


def _safety(path: Path) -> list[str]:
    safety = read_safety(path, load_model("ur5e"))
    return not_finite(safety, "safety") + published(safety=safety)


def _calibration(path: Path) -> list[str]:
    with suppress(ClientError):
        read_calibration_of_client(path)
    return published(model=read_calibration(path, load_model("ur5e")))


class _Driver:
    """Replaces URDriver: checks its setpoints."""

    program_running = True
    loss_reason = ""

    def __init__(self) -> None:
        self.sent: list[tuple[float, ...]] = []

    def speedj(self, qd_rad_s: Sequence[float], timeout_s: float) -> None:
        self.sent.append(from_words(to_words(qd_rad_s)))

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *_: None


ROBOT: Final = {
    "actual_q": (0.5,) * 6,
    "actual_qd": (0.01,) * 6,
    "actual_TCP_pose": (0.5, 0.0, 0.5, 0.0, 0.0, 0.0),
    "target_TCP_pose": (0.5, 0.0, 0.5, 0.0, 0.0, 0.0),
    "tcp_offset": (0.0,) * 6,
    "actual_TCP_force": (1.0,) * 6,
    "speed_scaling": 0.5,
    "target_speed_fraction": 1.0,
    "safety_mode": SafetyMode.NORMAL,
    "robot_mode": RobotMode.RUNNING,
    "runtime_state": RuntimeState.PLAYING,
}


def _controllers(path: Path) -> list[str]:
    """Output of controllers with these parameters on the way to a goal; none fails, but one may be stopped by name."""
    driver = _Driver()
    hardware = URHardware(cast(Any, driver), PolyscopeVersion(5, 12), cast(Any, None))
    manager = ControllerManager(hardware, read_controllers(path), 500.0)
    wrenches: list[Any] = []
    for cycle in range(8):
        time_s = 10.0 + 0.002 * cycle
        manager.cycle(ROBOT | {"timestamp": time_s}, time_s, 0.002)
        wrenches += [one.topic.latest for one in manager.active() if isinstance(one, ForceTorqueSensorBroadcaster)]
        if cycle == 2:
            manager.activate(*manager.file.types)
        if cycle == 3 and "arm" in manager.file.types:
            point = JointTrajectoryPoint((0.6,) * 6, (0.0,) * 6, time_from_start_s=0.004)
            manager.controller("arm").send_goal(JointTrajectory(JOINT_NAMES, (point,)))
        if hardware.failure is not None:
            assert "cannot be sent" in hardware.failure
            return []
    inactive = [one.name for one in manager.list_controllers() if one.state is not LifecycleState.ACTIVE]
    assert not inactive, "it failed"
    return not_finite([wrenches, driver.sent], "wrenches")


def outcome(use: Callable[[Path], list[str]], path: Path) -> tuple[list[str], str]:
    """Values that are not finite; the reason if the file is refused."""
    try:
        return use(path), ""
    except (ConfigError, ClientError) as error:
        return [], str(error)


READERS: Final[dict[str, tuple[Any, Callable[[Path], list[str]]]]] = {
    "initial positions": (POSITIONS, _positions),
    "world": (WORLD, _world),
    "safety": (SAFETY, _safety),
    "calibration, frames": (CALIBRATION, _calibration),
    "calibration, lists": (LISTS, _calibration),
    "controllers": (CONTROLLERS, _controllers),
}


@pytest.mark.parametrize("name", subset(READERS, now=("world", "controllers")))
def test_a_bad_number_is_refused_by_name_or_harmless(name: str, tmp_path: Path) -> None:
    content, use = READERS[name]
    path = tmp_path / "settings.yaml"
    path.write_text(yaml.safe_dump(content))
    assert use(path) == []  # unchanged, it is valid
    refused = 0
    for place in places(content):
        if len(place) > 1 and place[1] in SIBLINGS:
            continue
        for value in (*BAD, MISSING):
            path.write_text(yaml.safe_dump(changed(content, place, value)))
            found, problem = outcome(use, path)
            assert found == [], (place, str(value)[:40])
            if problem:
                refused += 1
                by_name = str(path) in problem or problem.startswith(("arm: ", "sensor: ", "hardware: "))
                assert by_name, (place, str(value)[:40], problem)
                assert len(problem) < 500, (place, str(value)[:40])
    assert refused > 40


@each_row("name", READERS)
def test_a_file_of_a_million_numbers_is_refused_quickly(name: str, tmp_path: Path) -> None:
    path = tmp_path / "settings.yaml"
    path.write_text("a: [" + "1, " * 1_000_000 + "]\n")
    with pytest.raises((ConfigError, ClientError), match="longer than"):
        READERS[name][1](path)


INSTALLATION: Final = (
    '<Installation name="default"><tcpOffset x="{}" y="0" z="0" rx="0" ry="0" rz="0"/>'
    '<payload mass="{}"/><gravity value="{}"/><payloadCogX>{}</payloadCogX></Installation>'
)


@each_row("number", ["nan", "inf", "-inf", "1e308", "1e999", "-1", "", "one", "1_0", "1" * 10_000])
def test_an_installation_with_a_bad_number_is_refused_or_finite(number: str) -> None:
    for place in range(4):
        numbers = ["0", "1", "0,0,9.82", "0"]
        numbers[place] = number
        try:
            read = read_installation(INSTALLATION.format(*numbers).encode(), "default")
        except DocumentError:
            continue
        assert not_finite(read, "installation") == []
