"""Packages whose public names are imported on first use: programs that need few of them start sooner."""

import ast
from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any


def exports(package: dict[str, Any]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """The functions ``__getattr__`` and ``__dir__`` of a package, whose globals are given.

    Its source has the imports, under ``if TYPE_CHECKING:``, where type checkers and editors see them.
    """

    @cache
    def homes() -> Mapping[str, str | None]:
        imports = (node for node in ast.walk(ast.parse(Path(package["__file__"]).read_text("utf-8")))
                   if isinstance(node, ast.ImportFrom))  # fmt: skip
        return {alias.name: node.module for node in imports for alias in node.names}

    def get(name: str) -> Any:
        if name not in package["__all__"]:
            raise AttributeError(f"module {package['__name__']!r} has no attribute {name!r}")
        value = package[name] = getattr(import_module(str(homes()[name])), name)
        return value

    return get, lambda: sorted({*package, *package["__all__"]})
