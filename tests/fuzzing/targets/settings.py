"""YAML files: worlds, safety settings, calibrations, positions, controllers and goals."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from client.calibration import read_calibration as read_calibration_of_client
from client.controllers.configuration import read_controllers
from client.controllers.goal_files import read_goals
from client.errors import ClientError
from emulator.config import (
    ConfigError,
    read_calibration,
    read_initial_positions,
    read_safety,
    read_surroundings,
)
from targets.registry import REPOSITORY, file, target
from urproto.robots import load_model

_GOLDEN: Final = REPOSITORY / "tests" / "golden"
_EXAMPLES: Final = REPOSITORY / "examples"
_CONTROLLERS: Final = REPOSITORY / "client" / "controllers"

_STRANGE_YAML: Final = (
    b"\xff",
    b"2001-99-99",
    b"[" * 2000,
    b"a: !!int x",
    b"a: !!int",
    b"? [a]\n: b",
    b"a: &a [*a]",
    b"1: .nan",
    b"!!timestamp 1",
)


def _examples(*paths: Path) -> Callable[[], Iterator[bytes]]:
    return lambda: iter([path.read_bytes() for path in paths] + list(_STRANGE_YAML))


@target(
    _examples(_EXAMPLES / "table.yaml"),
    b"tool:\n  box: [0.1, 0.1, 0.1]\n  pose: [0,0,0,0,0,0]\nlinks: true\nobjects:\n"
    b"  a: {sphere: 0.1, stiffness: 1e4}\n  b: {plane: {}}\n",
)
def world(data: bytes) -> None:
    with suppress(ConfigError):
        read_surroundings(file("world.yaml", data))


@target(
    _examples(),
    b"preset: default\nnormal: {tool_speed: 1.0, joint_position: {base: [-1, 1]}}\nplanes:\n"
    b"- {normal: [0,0,1], distance: 0.1}\n"
    b"tool_orientation: {direction: [0,0,1], deviation: 0.3}\ninputs: {emergency_stop: [0,1]}\n"
    b"safe_home: [0,0,0,0,0,0]\n",
)
def safety(data: bytes) -> None:
    with suppress(ConfigError):
        read_safety(file("safety.yaml", data), load_model("ur5e"))


@target(
    _examples(_GOLDEN / "calibration_ur5e.yaml", _GOLDEN / "calibration_ur5.yaml"),
    b"dh_theta: [0,0,0,0,0,0]\ndh_a: [0,-0.425,-0.3922,0,0,0]\ndh_d: [0.1625,0,0,0.1333,0.0997,0.0996]\n"
    b"dh_alpha: [1.570796327,0,0,1.570796327,-1.570796327,0]\n",
)
def calibration(data: bytes) -> None:
    path = file("calibration.yaml", data)
    with suppress(ConfigError):
        read_calibration(path, load_model("ur5e"))
    with suppress(ClientError):
        read_calibration_of_client(path)


@target(
    _examples(),
    b"shoulder_pan_joint: 0\nshoulder_lift_joint: -1.57\nelbow_joint: 0\nwrist_1_joint: 0\n"
    b"wrist_2_joint: 1\nwrist_3_joint: 2\n",
)
def initial_positions(data: bytes) -> None:
    with suppress(ConfigError):
        read_initial_positions(file("positions.yaml", data), load_model("ur5e"))


@target(_examples(_EXAMPLES / "goals.yaml", _CONTROLLERS / "ur_controllers.yaml"))
def controllers(data: bytes) -> None:
    path = file("controllers.yaml", data)
    for read in (read_controllers, read_goals):
        with suppress(ClientError):
            read(path)
