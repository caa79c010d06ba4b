"""Parts of the standard library that Python 3.10 lacks; from 3.11 on, these are the standard library's own.

Those of asyncio are in `urproto.compat_asyncio`, because the language and the codecs need no event loop.
"""

import sys
from typing import Any

if sys.version_info >= (3, 11):
    from enum import IntEnum, IntFlag, StrEnum
    from typing import Self, dataclass_transform
else:
    import enum

    from typing_extensions import Self, dataclass_transform

    class IntEnum(enum.IntEnum):
        """Members are numbers, and print as such: the old ones print their names."""

        def __str__(self) -> str:
            return int.__repr__(self)

        def __format__(self, format_spec: str) -> str:
            return int.__format__(self, format_spec)

    class IntFlag(enum.IntFlag):
        """The same of flags."""

        def __str__(self) -> str:
            return int.__repr__(self)

        def __format__(self, format_spec: str) -> str:
            return int.__format__(self, format_spec)

    class StrEnum(str, enum.Enum):
        """Members are strings, and print as their values."""

        __str__ = str.__str__

        def __format__(self, format_spec: str) -> str:
            return str.__format__(self, format_spec)


__all__ = ["IntEnum", "IntFlag", "Self", "StrEnum", "dataclass_transform", "load_toml", "module_command"]


def load_toml(text: str) -> dict[str, Any]:
    """Parse TOML. Raises ValueError if the text is not TOML."""
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib
    return tomllib.loads(text)


def module_command(module: str, *options: str) -> list[str]:
    """The command that runs a module with this Python, like ``python -P -m``: the current folder is not searched.

    options: of Python, such as ``-u``.
    """
    if sys.version_info >= (3, 11):
        return [sys.executable, "-P", *options, "-m", module]
    run = f"import sys, runpy; sys.path.remove(''); runpy.run_module({module!r}, run_name='__main__', alter_sys=True)"
    return [sys.executable, *options, "-c", run]
