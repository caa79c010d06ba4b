"""Finds what a user names: a policy, or a task of his own, in a Python file or a module."""

import importlib
import importlib.util
import sys
from pathlib import Path
from typing import Any


class EvaluationError(ValueError):
    """The evaluation cannot be carried out, for a reason that is the user's to change."""


def load_named(place: str) -> Any:
    """What a file or module calls so: ``policies.py:Reach``, ``package.module:Reach``. Raises EvaluationError."""
    source, _, name = place.rpartition(":")
    if not source or not name:
        raise EvaluationError(f"{place!r} must be FILE.py:NAME or MODULE:NAME")
    try:
        module = _module_of(Path(source)) if source.endswith(".py") else importlib.import_module(source)
    except Exception as error:  # a user's file may raise anything
        raise EvaluationError(f"{source} cannot be loaded: {_described(error)}") from error
    if not hasattr(module, name):
        raise EvaluationError(f"{source} has no {name}")
    return getattr(module, name)


def called(what: str, function: Any, *values: Any, **named: Any) -> Any:
    """Call what is a user's. Raises EvaluationError, which says where it failed."""
    try:
        return function(*values, **named)
    except Exception as error:
        raise EvaluationError(f"{what} failed: {_described(error)}") from error


def _module_of(path: Path) -> Any:
    name = path.stem
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    if str(path.parent.resolve()) not in sys.path:
        sys.path.insert(0, str(path.parent.resolve()))  # as for a script, which imports what is beside it
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def _described(error: Exception) -> str:
    """An error in one line, with the place of its innermost frame."""
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    place = "" if frame is None else f" ({Path(frame.tb_frame.f_code.co_filename).name}:{frame.tb_lineno})"
    text = " ".join(str(error).split())
    return f"{type(error).__name__}{place}: {text}" if text else f"{type(error).__name__}{place}"
