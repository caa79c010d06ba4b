"""The modules of the project as syntax trees, which all tests of the code itself share: reading them takes seconds."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("urproto", "urscript", "emulator", "client")


@cache
def modules() -> list[str]:
    """Dotted names of every module of the project."""
    files = (path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py")))
    return [module_name(path) for path in files if not path.name.endswith(".launch.py")]


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def module_path(name: str) -> Path:
    base = ROOT.joinpath(*name.split("."))
    return base / "__init__.py" if base.is_dir() else base.with_suffix(".py")


@cache
def syntax_tree(name: str) -> ast.Module:
    return ast.parse(module_path(name).read_text(encoding="utf-8"))


@cache
def nodes(name: str) -> list[ast.AST]:
    """Every node of a module's syntax tree."""
    return list(ast.walk(syntax_tree(name)))
