"""The suite itself: it sees a robot through the client only."""

import ast
from pathlib import Path


def test_no_case_looks_into_the_emulator():
    for path in Path(__file__).parent.glob("*.py"):
        nodes = list(ast.walk(ast.parse(path.read_text())))
        modules = {node.module for node in nodes if isinstance(node, ast.ImportFrom)}
        modules |= {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
        assert not {name for name in modules if name and name.split(".")[0] in ("emulator", "urscript")}, path.name
