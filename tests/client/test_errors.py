"""What a caller of the client has to catch."""

import ast
import inspect
from pathlib import Path

import client.errors
import urproto.errors
from urproto.errors import URError
from urproto.robots import CalibrationError

ROOT = Path(client.__file__).parent


def test_one_base_class_catches_whatever_the_client_raises_about_a_robot() -> None:
    modules = (client.errors, urproto.errors)
    errors = [kind for module in modules for kind in vars(module).values() if inspect.isclass(kind)]
    raised = [kind for kind in errors if issubclass(kind, Exception)]
    assert len(raised) > 20
    assert all(issubclass(kind, URError) for kind in (*raised, CalibrationError))
    assert client.URError is URError


def test_the_kinds_of_errors_are_listed_once() -> None:
    """Who catches both the client's errors and a robot's refusal means `URError`."""
    kinds = {"ClientError", "RobotRefused"}
    lists = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in ROOT.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Tuple) and kinds <= {part.id for part in node.elts if isinstance(part, ast.Name)}
    ]
    assert not lists
