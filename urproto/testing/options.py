"""What a test wants of its robot, as options of ``ur-emulator`` or as a configuration for virtual time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from urproto.joints import JOINT_NAMES

__all__ = ["JOINT_NAMES", "command_line", "write_positions"]


def command_line(options: Mapping[str, Any]) -> list[str]:
    """``speed=10, running=True`` as ``--speed 10 --running``. Lists repeat their option, None and False omit it."""
    words: list[str] = []
    for name, value in options.items():
        option = "--" + name.replace("_", "-")
        if value is True:
            words.append(option)
        elif value is not None and value is not False:
            values = value if isinstance(value, list | tuple) else [value]
            words += [word for item in values for word in (option, str(item))]
    return words


def write_positions(path: Path, q_rad: Sequence[float]) -> Path:
    """A file for ``--initial-positions``. Raises ValueError unless there are six angles."""
    path.write_text("".join(f"{name}: {float(q)}\n" for name, q in zip(JOINT_NAMES, q_rad, strict=True)))
    return path
