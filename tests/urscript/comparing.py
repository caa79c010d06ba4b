"""Runs programs as they are compiled with and without what is known of their variables, to compare what they do."""

from collections.abc import Mapping
from typing import Any, TypeAlias

import pytest

from urproto.versions import PolyscopeVersion
from urscript import LibrarySet, Runtime, compile_script, compiler
from urscript.builtins import Builtin
from urscript.inference import Kinds
from urscript.library import LIBRARIES
from urscript.syntax import Program
from urscript.values import to_text
from urscript.work import Steps

SET = LibrarySet(LIBRARIES)
VERSION = PolyscopeVersion.parse("5.22")
MAX_FRAMES = 300


class Host:
    period_s = 0.002

    def on_label(self, number: int, text: str, option: str, thread: Any) -> bool:
        raise AssertionError("these programs have no labels")


def _nothing_known(program: Program, builtins: Mapping[str, Builtin]) -> Steps[Kinds]:
    yield 1
    return Kinds(program, builtins, {})


Outcome: TypeAlias = tuple[list[Any], dict[str, tuple[str, str]], tuple[int, str] | None]
"""The variable ``total`` after each frame, the types and texts of all variables, and line and message of the error."""


def run(text: str) -> Outcome:
    """What a program does."""
    compiler._cache = compiler.CompiledPrograms()  # of a text that was compiled with other knowledge
    runtime = Runtime(compile_script(text, SET, VERSION), Host())
    compiler._cache = compiler.CompiledPrograms()
    frames: list[Any] = []
    while not runtime.finished and len(frames) < MAX_FRAMES:
        runtime.step()
        frames.append(runtime.globals.get("total"))
    values = {name: (value.__class__.__name__, to_text(value, limit=10**6)) for name, value in runtime.globals.items()}
    error = runtime.error
    return frames, values, None if error is None else (error.line, error.message)


def run_in_general(text: str) -> Outcome:
    """Like `run`, but nothing is known of the variables."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiler, "infer_kinds", _nothing_known)
        return run(text)
