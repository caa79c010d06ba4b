"""The robots of a fleet, and the address of each.

A fleet file is YAML; the keys of a robot are the options of ``ur-emulator`` and ``count``:

    robots:
      - {model: ur3, count: 3, running: true}
      - {model: ur5e, polyscope: 5.12.2, host: 127.0.0.20}
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from inspect import Parameter
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec

from emulator.config import ConfigError, EmulatorConfig, read_yaml
from urproto.structures import converted

FIRST_HOST: Final = "127.0.0.1"
MAX_ROBOTS: Final = 250  # of one fleet: the last byte of an address (guess; a machine reaches its limit earlier)

Options = Mapping[str, Any]


class FleetFile:
    """Reads fleet files. parameters: the options of one robot; paths are relative to the file."""

    def __init__(self, parameters: Mapping[str, Parameter]) -> None:
        count = ("count", Annotated[int, msgspec.Meta(ge=1, le=MAX_ROBOTS)], 1)
        fields = [(name, parameter.annotation, parameter.default) for name, parameter in parameters.items()]
        self._robot = msgspec.defstruct("Robot", [count, *fields], kw_only=True, forbid_unknown_fields=True)
        self._file = msgspec.defstruct("Fleet", [("robots", list[dict[str, Any]])], forbid_unknown_fields=True)

    def read(self, path: Path) -> list[Options]:
        """The options that the file gives for each robot, without defaults. Raises ConfigError."""
        content = _convert(read_yaml(path), self._file, path.parent, str(path))
        robots: list[Options] = []
        for number, entry in enumerate(content.robots, 1):
            robots += self._expand(entry, path.parent, f"{path}: entry {number}")
        if not 1 <= len(robots) <= MAX_ROBOTS:
            raise ConfigError(f"{path} has {len(robots)} robots: a fleet has 1 to {MAX_ROBOTS}")
        return robots

    def _expand(self, entry: dict[str, Any], folder: Path, where: str) -> list[Options]:
        """Repeat an entry for each of its robots."""
        entry = {str(name).replace("-", "_"): value for name, value in entry.items()}
        robot = _convert(entry, self._robot, folder, where)
        if "host" in entry and robot.count > 1:
            raise ConfigError(f"{where}: {robot.count} robots cannot share the host {robot.host}: leave it out")
        return [{name: getattr(robot, name) for name in entry if name != "count"}] * robot.count


def _convert(content: Any, kind: Any, folder: Path, where: str) -> Any:
    def path(expected: type, text: Any) -> Any:
        if expected is Path and isinstance(text, str):
            return folder / text
        raise TypeError(f"Expected `{expected.__name__}`, got `{text!r}`")

    return converted(content, kind, where, ConfigError, dec_hook=path)


def place(
    robots: Sequence[Options], configure: Callable[..., EmulatorConfig], first_host: str = FIRST_HOST
) -> list[EmulatorConfig]:
    """Create a configuration for each robot. Robots without a host get free addresses, from first_host on.

    Raises ConfigError, which names the robot, also if two robots use the same port.
    """
    named = {robot["host"] for robot in robots if "host" in robot}
    addresses = (address for address in _successive(first_host) if address not in named)
    configs = []
    for number, robot in enumerate(robots, 1):
        host = robot["host"] if "host" in robot else next(addresses)
        try:
            configs.append(configure(**{**robot, "host": host}))
        except ConfigError as error:
            raise ConfigError(f"robot {number}, {host}: {error}") from error
    _check_ports(configs)
    return configs


def _successive(first: str) -> Iterator[str]:
    try:
        address = ip_address(first)
        for step in range(2 * MAX_ROBOTS):
            yield str(address + step)
    except ValueError as error:
        raise ConfigError(
            f"--first-host must be an address with enough addresses after it, such as {FIRST_HOST}: {error}"
        ) from None


def _check_ports(configs: Sequence[EmulatorConfig]) -> None:
    taken: dict[tuple[str, int], int] = {}
    for number, config in enumerate(configs, 1):
        for name, port in config.wanted_ports.items():
            if not port or name in config.movable:
                continue
            other = taken.setdefault((config.host, port), number)
            if other != number:
                raise ConfigError(f"robots {other} and {number} both use {name} port {port} on {config.host}")
